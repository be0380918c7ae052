"""The link service: ``python -m services.link SCENARIO``. It embeds both routers and keeps mission time."""

from services.runtime.entry import leave, prepare_service


def main() -> int:
    """Exit code of the process."""
    from services.link.clock_keeper import ClockKeeper
    from services.link.lockstep_driver import TimeManagerDriver
    from services.link.node import build_node
    from services.link.routers import router_on
    from services.runtime.drivers.wall_clock import WallClockDriver
    from services.runtime.process import serve
    from services.runtime.service import Service

    return serve(
        Service("link", lambda options: build_node(options.scenario)),
        on_wall_clock=lambda context: WallClockDriver(context, ClockKeeper(context)),
        in_lockstep=TimeManagerDriver,
        open_side=router_on,
    )


if __name__ == "__main__":
    prepare_service()
    leave(main())
