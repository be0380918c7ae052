"""The field service: ``python -m services.field SCENARIO``."""

from services.field.node import build_node
from services.node import Node
from services.options import Options
from services.run import Service
from services.serve import leave, serve


def build(options: Options) -> Node:
    return build_node(options.scenario)


if __name__ == "__main__":
    leave(serve(Service("field", build)))
