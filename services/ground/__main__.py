"""The ground service: ``python -m services.ground SCENARIO``."""

from services.ground.map.process import map_answers
from services.ground.node import build_node
from services.ground.planner_process import PlannerProcess
from services.runtime.drivers.wall_clock import Service
from services.runtime.entry import leave, serve
from services.runtime.node import Node
from services.runtime.options import Options


def build(options: Options) -> Node:
    return build_node(options.scenario)


if __name__ == "__main__":
    service = Service("ground", build, executor=PlannerProcess, answers=map_answers(), journals=True)
    leave(serve(service))
