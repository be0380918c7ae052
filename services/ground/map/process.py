"""Answers operators' questions of the map, for the ground's process: ``python -m services.ground.map.process``."""

import sys

from services.ground.map.feed_publisher import FeedPublisher
from services.ground.map.history import remembering
from services.ground.map.rendering import Renderer
from services.ground.map.service import MAP_TOPICS, answer
from services.runtime.queries.process import serve_from_pipe
from services.runtime.queries.server import QueryService

MODULE = "services.ground.map.process"


def map_answers() -> QueryService:
    """How the map is asked, and how it answers."""
    return QueryService(MAP_TOPICS, answer, render=Renderer(), keep=remembering, module=MODULE)


if __name__ == "__main__":
    sys.exit(serve_from_pipe(map_answers(), "ground", FeedPublisher(), sys.argv[1:]))
