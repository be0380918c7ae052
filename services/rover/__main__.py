"""The rover service: ``python -m services.rover SCENARIO``."""

from services.runtime.entry import leave, prepare_service


def main() -> int:
    """Exit code of the process."""
    from services.rover.node import build_node
    from services.runtime.process import serve
    from services.runtime.service import Service

    return serve(Service("rover", lambda options: build_node(options.scenario), journals=True))


if __name__ == "__main__":
    prepare_service()
    leave(main())
