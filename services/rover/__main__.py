"""The rover service: ``python -m services.rover SCENARIO``."""

from services.node import Node
from services.options import Options
from services.rover.node import build_node
from services.run import Service
from services.serve import leave, serve


def build(options: Options) -> Node:
    return build_node(options.scenario)


if __name__ == "__main__":
    leave(serve(Service("rover", build, journals=True)))
