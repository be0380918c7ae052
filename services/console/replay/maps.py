"""The live map as it was at any time of a recording: answers to the queries of the map.

The belief is rebuilt from the recorded samples (`services.console.report.verification`), from the last fit before the
revision on, so that any revision takes about a second, and the next ones milliseconds. It is equal to the map of the
mission to the byte, on the same kind of machine.
"""

from __future__ import annotations

import base64
import threading
from collections import OrderedDict
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from he3.errors import He3Error, InvalidInput, NotReady
from he3.frames import SiteGrid
from schemas.maps import MapHistory, MapRevision, MapSite
from schemas.topics import INTERESTS, MAP_HISTORY
from services.console.replay.followed import FollowedGround
from services.console.report.verification import RebuiltBelief
from services.ground.map.history import revision_at
from services.ground.map.region_account import region_account
from services.ground.map.rendering import Renderer
from services.ground.map.service import answer
from services.ground.map.snapshot import MapSnapshot
from services.ground.node import terrain_of
from services.ground.terrain import GroundTerrain
from services.mission.region_folder import is_recorded
from services.mission.regions import load_region
from services.recorder.about import REGION_RECORD

if TYPE_CHECKING:
    from collections.abc import Sequence

    from he3.frames import BoolArray
    from he3.gp import GaussianProcess
    from he3.intervals import Intervals
    from he3.posterior.grid import PosteriorMap
    from he3.reference import Region
    from schemas.ground import MapOverview
    from schemas.maps import MapRegion, MapScore
    from schemas.topics import Topic
    from schemas.wire import Wire
    from services.console.replay.tape import Heard, Tape
    from services.mission.mission_time import MissionTime
    from services.runtime.queries.server import Encoded

    _Rebuilt = tuple[PosteriorMap, Intervals | None, GaussianProcess, tuple[str, ...]]

MAX_KEPT_BYTES: Final = 256 * 1024 * 1024  # of maps that were rebuilt

NO_REGION: Final = "open ground is that of the recorded overviews, since the mission's region is not here"


class RecordedMaps:
    """The maps of a recording. Its methods may be called from any thread."""

    def __init__(self, tape: Tape, region: Region | None = None) -> None:
        """region: the mission's; None: the one that the scenario names, if it is on this machine."""
        self._tape = tape
        self._region = region or _region_of(tape)
        self.notes: tuple[str, ...] = () if self._region is not None or not tape.overviews else (NO_REGION,)
        """One line on each part of the map that is not as it was."""
        self._account: MapRegion | None = None
        scenario = tape.evidence.scenario
        if scenario is not None and self._region is not None:
            self._account = region_account(scenario, self._region)
        self._render = Renderer()
        self._lock = threading.Lock()
        self._rebuilt: tuple[int, RebuiltBelief] | None = None
        self._kept: OrderedDict[int, _Rebuilt] = OrderedDict()
        self._ground = FollowedGround(tape, partial(_terrain, tape, self._region))
        self._fitted = _scores_of_fits(tape)

    def answer(self, topic: Topic, request: Any, now: MissionTime) -> Wire | Encoded:
        """The reply to a query of the map at that time; raises He3Error with one line."""
        known = self._tape.revisions_by(now)
        if not known:
            raise NotReady("there is no map yet at this time of the recording")
        if topic is MAP_HISTORY:
            return self._history(known)
        when = getattr(request, "as_of", None)
        revision = revision_at([each.body for each in known], when).revision
        index = next(number for number, each in enumerate(known) if each.body.revision == revision)
        snapshot = self._snapshot(index, now)
        if when is not None:
            request = request.model_copy(update={"as_of": None})
        rendered = self._render(topic, request, snapshot)
        return answer(topic, request, snapshot) if rendered is None else rendered

    def _history(self, known: Sequence[Heard]) -> MapHistory:
        first: MapOverview = known[0].body
        return MapHistory(
            site=MapSite(
                rows=first.rows, columns=first.columns, resolution_m=first.resolution_m,
                origin_lat_deg=first.origin_lat_deg, origin_lon_deg=first.origin_lon_deg,
                noise_std_ppb=known[-1].body.kernel.noise_std_ppb,
                provenance="" if self._account is None else self._account.provenance,
            ),
            revisions=tuple(
                MapRevision(
                    revision=each.body.revision, samples=each.body.samples, mission_time_ns=each.body.mission_time_ns,
                    mean_std_ppb=self._tape.mean_std_ppb.get(each.body.revision, 0.0),
                )
                for each in known
            ),
        )  # fmt: skip

    def _snapshot(self, index: int, now: MissionTime) -> MapSnapshot:
        """The map of that revision as it was last shown by that time."""
        overviews = self._tape.overviews
        overview: MapOverview = overviews[index].body
        shown_until = now if index + 1 == len(overviews) else min(now, overviews[index + 1].at - 1)
        with self._lock:
            current, intervals, process, samples = self._map(index)
            driven, planned = self._ground.paths(self._tape.told_by_ground(shown_until))
            changed = self._tape.of(INTERESTS, shown_until)
            terrain = self._ground.terrain.traversable
        open_cells = terrain if self._region is not None else _open_cells(overview)
        origin = overview.origin_lat_deg, overview.origin_lon_deg
        return MapSnapshot(
            grid=SiteGrid(overview.rows, overview.columns, overview.resolution_m),
            mean_ppb=current.mean_ppb, std_ppb=current.std_ppb, intervals=intervals, traversable=open_cells,
            samples=tuple(self._tape.evidence.samples[name] for name in samples),
            driven_path_m=driven, planned_path_m=planned, plan_ends=None, revision=overview.revision,
            mission_time_ns=overview.mission_time_ns, score=self._tape.scores.get(overview.revision),
            score_history=tuple(score for revision, score in self._fitted if revision <= overview.revision),
            process=process, origin_deg=None if origin[0] is None or origin[1] is None else (origin[0], origin[1]),
            provenance="" if self._account is None else self._account.provenance, region=self._account,
            keep_outs=overview.keep_outs,
            interests=changed[-1].body.areas if changed else self._tape.evidence.interests_at_first(),
        )  # fmt: skip

    # --- the belief, which the lock protects ------------------------------------------------------------------------

    def _map(self, index: int) -> _Rebuilt:
        """The map of that revision, its intervals, the process behind it, and its samples in the order of arrival."""
        if index in self._kept:
            self._kept.move_to_end(index)
            return self._kept[index]
        overviews = [each.body for each in self._tape.overviews]
        fitted = _last_fit(overviews, index)
        if self._rebuilt is None or not fitted <= self._rebuilt[0] <= index:
            belief = RebuiltBelief(overviews[0], self._tape.evidence)
            if fitted == 0:
                belief.follow(overviews[0])
            else:
                belief.begin_at(overviews[fitted], self._samples(fitted))
            self._rebuilt = fitted, belief
        at, belief = self._rebuilt
        for number in range(at + 1, index + 1):
            belief.follow(overviews[number])
            self._rebuilt = number, belief
        current, intervals = belief.belief.map, belief.belief.intervals
        self._kept[index] = kept = current, intervals, belief.belief.process, self._samples(index)
        each = current.mean_ppb.nbytes + current.std_ppb.nbytes + (0 if intervals is None else intervals.nbytes)
        while len(self._kept) > max(1, MAX_KEPT_BYTES // each):
            self._kept.popitem(last=False)
        return kept

    def _samples(self, index: int) -> tuple[str, ...]:
        """The samples of that revision, in the order of their arrival; of overviews that were lost, of their delivery.

        Raises He3Error where the recording has fewer.
        """
        overviews = self._tape.overviews
        names = [name for each in overviews[: index + 1] for name in each.body.added]
        lost = overviews[index].body.samples - len(names)
        known = set(names)
        between = [name for name in self._tape.evidence.samples if name not in known][: max(0, lost)]
        if len(between) != max(0, lost):
            raise He3Error(
                f"revision {overviews[index].body.revision} of the map cannot be rebuilt: samples are missing"
            )
        return (*between, *names)


def _last_fit(overviews: Sequence[MapOverview], index: int) -> int:
    """Index of the last revision up to that one whose map was rebuilt with new hyperparameters; else 0."""
    return next((k for k in range(index, 0, -1) if overviews[k].fits != overviews[k - 1].fits), 0)


def _scores_of_fits(tape: Tape) -> tuple[tuple[int, MapScore], ...]:
    """Revision and score of each map that was rebuilt with new hyperparameters, once a round."""
    revisions = [each.body for each in tape.overviews]
    fitted = [later.revision for before, later in pairwise(revisions) if later.fits > before.fits]
    return tuple((revision, tape.scores[revision]) for revision in fitted if revision in tape.scores)


def _region_of(tape: Tape) -> Region | None:
    """The region that the scenario of the recording names; None if there is none on this machine that fits."""
    scenario = tape.evidence.scenario
    if scenario is None or not tape.overviews:
        return None
    first = tape.overviews[0].body
    try:
        region = load_region(scenario.region, scenario.field.field_seed)
    except He3Error:
        return None
    if not is_recorded(scenario.region, tape.evidence.about.get(REGION_RECORD)):
        return None
    return region if region.grid == SiteGrid(first.rows, first.columns, first.resolution_m) else None


def _terrain(tape: Tape, region: Region | None) -> GroundTerrain:
    """The terrain when the mission began; without its region all of it is open."""
    scenario = tape.evidence.scenario
    if scenario is not None and region is not None:
        return terrain_of(scenario, region)
    if not tape.overviews:
        raise InvalidInput(f"{tape.path}: expected a recording with overviews of the map, got none")
    first = tape.overviews[0].body
    grid = SiteGrid(first.rows, first.columns, first.resolution_m)
    return GroundTerrain(grid, np.ones(grid.shape, dtype=np.bool_))


def _open_cells(overview: MapOverview) -> BoolArray:
    """Where the rover's centre may be, from the cells of an overview; everywhere if it has none."""
    shape = overview.rows, overview.columns
    if overview.values is None:
        return np.ones(shape, dtype=np.bool_)
    values = overview.values
    coarse = np.frombuffer(base64.b64decode(values.traversable_base64), dtype=np.uint8)
    coarse = coarse.reshape(values.rows, values.columns)
    rows = np.minimum(np.arange(shape[0]) // overview.step, values.rows - 1)
    columns = np.minimum(np.arange(shape[1]) // overview.step, values.columns - 1)
    return np.asarray(coarse[np.ix_(rows, columns)] > 0)
