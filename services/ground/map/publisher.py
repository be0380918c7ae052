"""Makes the map that operators see: a new snapshot whenever map, track, plan or areas have changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Literal

from schemas.ground import KeepOutArea
from schemas.topics import MAP_OVERVIEW
from services.ground.map.overview import overview
from services.ground.map.snapshot import MapSnapshot
from services.runtime.node import PublishSnapshot, SendIfHeard

if TYPE_CHECKING:
    from schemas.maps import MapRegion, MapScore
    from services.ground.belief import Belief
    from services.ground.interests import InterestAreas
    from services.ground.refits import RefitSchedule
    from services.ground.round_log import RoundLog
    from services.ground.samples import SampleIntake
    from services.ground.scoring import Scorer
    from services.ground.terrain import GroundTerrain
    from services.mission.mission_time import MissionTime
    from services.runtime.node import SavedState


MapUse = Literal["always", "rounds", "asked"]
"""When a map is computed: at every change, as for operators; once a round and when asked for; only when asked for."""


class MapPublisher:
    """Publishes what has changed since the last snapshot. Its revision grows with every change of map or terrain."""

    def __init__(
        self,
        belief: Belief,
        terrain: GroundTerrain,
        samples: SampleIntake,
        round_log: RoundLog,
        refits: RefitSchedule,
        interests: InterestAreas,
        scorer: Scorer | None,
        origin_deg: tuple[float, float] | None,
        start: MissionTime,
        region: MapRegion | None = None,
        use: MapUse = "always",
    ) -> None:
        """scorer: None where there is no reference; origin_deg: latitude and longitude of the site's south-west corner
        where they are known; start: when the mission begins. use: unless "always", snapshots are not published but
        made when they are asked for; "asked" leaves out the scores of the rounds."""
        self._belief = belief
        self._terrain = terrain
        self._samples = samples
        self._round_log = round_log
        self._refits = refits
        self._interests = interests
        self._scorer = scorer
        self._origin_deg = origin_deg
        self._region = region
        self._use = use
        self._noted = -1
        self._traversable: object = None
        self._map_time = start
        self._rounds_scored = 0
        self._history: tuple[MapScore, ...] = ()
        self._shown_at_the_end = False
        self._samples_noted = 0
        self.revision = 0
        self._ended = False
        self._judged = 0
        self._mean_std_ppb = 0.0
        self._score: MapScore | None = None
        self.snapshot: MapSnapshot | None = None
        """The map as it was last made."""

    @property
    def mean_std_ppb(self) -> float:
        """Mean over the cells of the standard deviation [ppb]; with one map a round, that of the last round."""
        if self._use != "rounds" or self._ended:
            self._judge()
        return self._mean_std_ppb

    @property
    def score(self) -> MapScore | None:
        """The score of the map; None where there is no reference, and before the first map. Of which map: as above."""
        if self._use != "rounds" or self._ended:
            self._judge()
        return self._score

    def _judge(self) -> None:
        """Bring mean standard deviation and score up to the present map."""
        if self._judged == self.revision:
            return
        self._judged, current = self.revision, self._belief.map
        self._mean_std_ppb = float(current.std_ppb.mean(dtype="f8"))
        if self._scorer is not None:
            self._score = self._scorer.score(
                current.mean_ppb, current.std_ppb, self.revision, self._samples_noted, self._map_time,
                self._belief.interval_ends(),
            )  # fmt: skip

    def present(self, now: MissionTime, plan_ends: Callable[[MissionTime], MissionTime | None]) -> MapSnapshot | None:
        """The map as operators see it now; None before there is one. plan_ends: as for `publish`."""
        if self._use != "always" and self.revision:
            self._make(now, plan_ends)
        return self.snapshot

    def publish(
        self, now: MissionTime, ended: bool, plan_ends: Callable[[MissionTime], MissionTime | None]
    ) -> Iterable[PublishSnapshot | SendIfHeard]:
        """A new snapshot if there is something new, with an overview if the map is; ended: whether the mission is over.

        plan_ends: the expected end of all planned rounds; called for new snapshots only.
        """
        self._ended = ended
        self._note_changes(now)
        if self._use != "always":
            return
        before = self.snapshot
        shown = self._make(now, plan_ends)
        if shown is before:
            if ended and not self._shown_at_the_end:
                self._shown_at_the_end = True
                yield PublishSnapshot(shown, awaited=True)
            return
        # Reports are made from queries that come as soon as the status says that the mission is over.
        self._shown_at_the_end = ended
        yield PublishSnapshot(shown, awaited=self._shown_at_the_end)
        if before is None or before.revision != self.revision:
            known = 0 if before is None else len(before.samples)
            yield SendIfHeard(MAP_OVERVIEW, partial(overview, shown, known, self._belief.fits))

    def _make(self, now: MissionTime, plan_ends: Callable[[MissionTime], MissionTime | None]) -> MapSnapshot:
        """The snapshot of what was noted last: the one that was made last, if it shows that."""
        driven, planned = self._round_log.paths()
        interests = self._interests.listed().areas
        before = self.snapshot
        if (
            before is not None
            and before.revision == self.revision
            and before.driven_path_m is driven
            and before.planned_path_m is planned
            and (before.interests is interests or before.interests == interests)
        ):
            return before
        self._judge()
        current = self._belief.map
        self.snapshot = MapSnapshot(
            grid=self._belief.grid,
            mean_ppb=current.mean_ppb,
            std_ppb=current.std_ppb,
            intervals=self._belief.intervals,
            traversable=self._terrain.traversable,
            samples=self._samples.reports,
            driven_path_m=driven,
            planned_path_m=planned,
            plan_ends=plan_ends(now),
            revision=self.revision,
            mission_time_ns=self._map_time,
            score=self._score,
            score_history=self._history,
            process=self._belief.process,
            origin_deg=self._origin_deg,
            provenance="" if self._region is None else self._region.provenance,
            region=self._region,
            keep_outs=tuple(
                KeepOutArea(area_id=area_id, polygon_m=outline)
                for area_id, outlines in self._terrain.outlines.items()
                for outline in outlines
            ),
            interests=interests,
        )
        return self.snapshot

    def _note_changes(self, now: MissionTime) -> None:
        """A new revision, with a score of the round, if the map has changed or the terrain is another object."""
        changes, traversable = self._belief.changes, self._terrain.traversable
        if self._noted == changes and self._traversable is traversable:
            return
        self._noted, self._traversable = changes, traversable
        self.revision += 1
        self._map_time = now
        self._samples_noted = len(self._samples)
        if self._use != "asked" and self._refits.rounds > self._rounds_scored:
            self._judge()
            if self._score is not None:
                self._history = (*self._history, self._score)
        self._rounds_scored = self._refits.rounds

    def checkpoint(self) -> SavedState:
        """The whole state, as named parts."""
        return {
            "noted": self._noted,
            "samples_noted": self._samples_noted,
            "traversable": self._traversable,
            "map_time": self._map_time,
            "rounds_scored": self._rounds_scored,
            "history": self._history,
            "shown_at_the_end": self._shown_at_the_end,
            "revision": self.revision,
            "ended": self._ended,
            "judged": self._judged,
            "mean_std_ppb": self._mean_std_ppb,
            "score": self._score,
            "snapshot": self.snapshot,
        }

    def restore(self, state: SavedState) -> None:
        """Restore the publisher from this state."""
        self._noted = state["noted"]
        self._samples_noted = state["samples_noted"]
        self._traversable = state["traversable"]
        self._map_time = state["map_time"]
        self._rounds_scored = state["rounds_scored"]
        self._history = state["history"]
        self._shown_at_the_end = state["shown_at_the_end"]
        self.revision = state["revision"]
        self._ended = state["ended"]
        self._judged = state["judged"]
        self._mean_std_ppb = state["mean_std_ppb"]
        self._score = state["score"]
        self.snapshot = state["snapshot"]
