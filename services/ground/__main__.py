"""The ground service: ``python -m services.ground SCENARIO``."""

import sys

from services.ground.map_service import MAP_TOPICS, answer
from services.ground.node import build_node
from services.ground.planner_process import PlannerProcess
from services.node import Node
from services.options import Options
from services.questions import SnapshotService
from services.run import Service
from services.serve import serve


def build(options: Options) -> Node:
    return build_node(options.scenario)


if __name__ == "__main__":
    service = Service(
        "ground", build, executor=PlannerProcess, answers=SnapshotService(MAP_TOPICS, answer), journals=True
    )
    sys.exit(serve(service))
