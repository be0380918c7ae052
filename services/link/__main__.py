"""The link service: ``python -m services.link SCENARIO``. It embeds both routers and keeps mission time."""

from services.link.lockstep import LockstepLinkProcess
from services.link.node import build_node
from services.link.process import LinkProcess
from services.node import Node
from services.options import Options
from services.run import Service
from services.serve import leave, serve


def build(options: Options) -> Node:
    return build_node(options.scenario)


if __name__ == "__main__":
    leave(serve(Service("link", build), on_wall_clock=LinkProcess, in_lockstep=LockstepLinkProcess))
