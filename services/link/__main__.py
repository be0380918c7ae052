"""The link service: ``python -m services.link SCENARIO``. It embeds both routers and keeps mission time."""

from services.runtime.entry import leave, prepare_service


def main() -> int:
    """Exit code of the process."""
    from services.link.clock_keeper import ClockKeeper
    from services.link.kept_conditions import kept_conditions
    from services.link.lockstep_driver import TimeManagerDriver
    from services.link.node import LinkNode, build_node
    from services.link.open_files import allow_connections
    from services.link.routers import router_on
    from services.runtime.drivers.wall_clock import WallClockDriver
    from services.runtime.kept_file import kept_file
    from services.runtime.options import Options
    from services.runtime.process import serve
    from services.runtime.service import Service

    def link_of(options: Options) -> LinkNode:
        scenario, folder = options.scenario, options.journal
        if folder is None:
            return build_node(scenario)
        return build_node(scenario, kept=kept_conditions(kept_file(folder, "link"), scenario.name, scenario.link))

    allow_connections()
    return serve(
        Service("link", link_of),
        on_wall_clock=lambda context: WallClockDriver(context, ClockKeeper(context)),
        in_lockstep=TimeManagerDriver,
        open_side=router_on,
    )


if __name__ == "__main__":
    prepare_service()
    leave(main())
