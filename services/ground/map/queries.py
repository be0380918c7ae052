"""Which queries of the map are answered, how, and in which process."""

from services.ground.map.history import with_history
from services.ground.map.rendering import Renderer
from services.ground.map.service import MAP_TOPICS, answer
from services.runtime.queries.server import QueryService

MODULE = "services.ground.map.process"
"""The module that is run as the query process."""


def map_queries() -> QueryService:
    """The query service of the map, in a process of its own."""
    return QueryService(MAP_TOPICS, answer, render=Renderer(), keep=with_history, module=MODULE)
