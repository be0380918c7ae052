"""The rover service: ``python -m services.rover SCENARIO``."""

from services.rover.node import build_node
from services.runtime.drivers.wall_clock import Service
from services.runtime.entry import leave, serve
from services.runtime.node import Node
from services.runtime.options import Options


def build(options: Options) -> Node:
    return build_node(options.scenario)


if __name__ == "__main__":
    leave(serve(Service("rover", build, journals=True)))
