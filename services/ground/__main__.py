"""The ground service: ``python -m services.ground SCENARIO``."""

from services.runtime.entry import leave, prepare_service


def main() -> int:
    """Exit code of the process."""
    from services.ground.map.service import MAP_TOPICS
    from services.ground.node import build_node
    from services.ground.planner_process import PlannerProcess
    from services.runtime.process import serve
    from services.runtime.service import QueryModule, Service

    return serve(
        Service(
            "ground",
            lambda options: build_node(options.scenario),
            executor=PlannerProcess,
            queries=QueryModule("services.ground.map.process", MAP_TOPICS),
            journals=True,
        )
    )


if __name__ == "__main__":
    prepare_service()
    leave(main())
