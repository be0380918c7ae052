"""The link service: ``python -m services.link SCENARIO``. It embeds both routers and keeps mission time."""

from services.link.lockstep_process import LockstepLinkProcess
from services.link.node import build_node
from services.link.process import LinkProcess
from services.runtime.drivers.wall_clock import Service
from services.runtime.entry import leave, serve
from services.runtime.node import Node
from services.runtime.options import Options


def build(options: Options) -> Node:
    return build_node(options.scenario)


if __name__ == "__main__":
    leave(serve(Service("link", build), on_wall_clock=LinkProcess, in_lockstep=LockstepLinkProcess))
