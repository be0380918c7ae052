"""Which queries of the map are answered, how, and in which process."""

from services.ground.map.history import with_history
from services.ground.map.rendering import Renderer
from services.ground.map.service import MAP_TOPICS, SLOW_TOPICS, answer
from services.runtime.queries.server import QueryService


def map_queries() -> QueryService:
    """The queries of the map, and the functions that answer them."""
    return QueryService(MAP_TOPICS, answer, render=Renderer(), keep=with_history, slow=SLOW_TOPICS)
