"""The link service: ``python -m services.link SCENARIO``. It embeds both routers and keeps mission time."""

from services.runtime.entry import leave, prepare_service


def main() -> int:
    """Exit code of the process."""
    from services.link.lockstep_process import LockstepLinkProcess
    from services.link.node import build_node
    from services.link.process import LinkProcess
    from services.runtime.drivers.wall_clock import Service
    from services.runtime.process import serve

    service = Service("link", lambda options: build_node(options.scenario))
    return serve(service, on_wall_clock=LinkProcess, in_lockstep=LockstepLinkProcess)


if __name__ == "__main__":
    prepare_service()
    leave(main())
