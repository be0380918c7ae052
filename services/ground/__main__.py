"""The ground service: ``python -m services.ground SCENARIO``."""

from services.runtime.entry import leave, prepare_service


def main() -> int:
    """Exit code of the process."""
    from services.ground.map.queries import map_queries
    from services.ground.node import build_node
    from services.ground.planner_process import PlannerProcess
    from services.runtime.drivers.wall_clock import Service
    from services.runtime.process import serve

    return serve(
        Service(
            "ground",
            lambda options: build_node(options.scenario),
            executor=PlannerProcess,
            answers=map_queries(),
            journals=True,
        )
    )


if __name__ == "__main__":
    prepare_service()
    leave(main())
