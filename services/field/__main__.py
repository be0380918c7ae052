"""The field service: ``python -m services.field SCENARIO``."""

from services.field.node import build_node
from services.runtime.drivers.wall_clock import Service
from services.runtime.entry import leave, serve
from services.runtime.node import Node
from services.runtime.options import Options


def build(options: Options) -> Node:
    return build_node(options.scenario)


if __name__ == "__main__":
    leave(serve(Service("field", build)))
