"""The ground service: ``python -m services.ground SCENARIO``."""

from services.ground.map_process import map_answers
from services.ground.node import build_node
from services.ground.planner_process import PlannerProcess
from services.node import Node
from services.options import Options
from services.run import Service
from services.serve import leave, serve


def build(options: Options) -> Node:
    return build_node(options.scenario)


if __name__ == "__main__":
    service = Service("ground", build, executor=PlannerProcess, answers=map_answers(), journals=True)
    leave(serve(service))
