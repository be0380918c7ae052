"""Answers operators' questions of the map, for the ground's process: ``python -m services.ground.map.process``."""

import sys

from services.ground.map.feed import FeedMap
from services.ground.map.history import remembering
from services.ground.map.rendering import Renderer
from services.ground.map.service import MAP_TOPICS, answer
from services.ground.map.snapshot import MapSnapshot
from services.runtime.queries.process import answer_from_pipe
from services.runtime.queries.server import SnapshotService

MODULE = "services.ground.map.process"


def feed_of(snapshot: MapSnapshot) -> FeedMap:
    """What of a snapshot goes into the feed."""
    return FeedMap(
        snapshot.mean_ppb,
        snapshot.std_ppb,
        snapshot.traversable,
        snapshot.grid.resolution_m,
        snapshot.revision,
        len(snapshot.samples),
        snapshot.mission_time_ns,
    )


def map_answers() -> SnapshotService:
    """How the map is asked, and how it answers."""
    return SnapshotService(MAP_TOPICS, answer, render=Renderer(), keep=remembering, module=MODULE)


if __name__ == "__main__":
    sys.exit(answer_from_pipe(map_answers(), "ground", feed_of, sys.argv[1:]))
