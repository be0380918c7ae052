"""The field service: ``python -m services.field SCENARIO``."""

from services.runtime.entry import leave, prepare_service


def main() -> int:
    """Exit code of the process."""
    from services.field.node import build_node
    from services.runtime.process import serve
    from services.runtime.service import Service

    return serve(Service("field", lambda options: build_node(options.scenario)))


if __name__ == "__main__":
    prepare_service()
    leave(main())
