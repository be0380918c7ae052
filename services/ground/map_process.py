"""Answers operators' questions of the map, for the ground's process: ``python -m services.ground.map_process``."""

import sys

from services.answering import answer_from_pipe
from services.ground.history import remembering
from services.ground.map_service import MAP_TOPICS, answer
from services.ground.rendering import Renderer
from services.ground.snapshot import MapSnapshot
from services.mapfeed import FeedMap
from services.questions import SnapshotService

MODULE = "services.ground.map_process"


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
