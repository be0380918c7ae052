"""A recording, verified: the belief is rebuilt from the recorded samples and compared with the map that was recorded.

The belief follows from the samples, their order, and the hyperparameters of each fit. A recording has all three: the
reports of the rover, and an overview of each revision of the map. So the whole map can be computed again with the
ground's own `Belief`, revision by revision. Each overview has values of the map and a checksum of all of them. Maps of
the same machine are equal to the byte; another processor may round the last digit of a float32 otherwise.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from pydantic import ValidationError

from he3.errors import He3Error, InvalidInput
from he3.frames import Float32Array, SiteGrid
from he3.trend import CovariateTrend
from schemas.ground import InterestArea
from schemas.topics import MAP_OVERVIEW, PLAN, SAMPLE
from schemas.validation import one_line
from services.ground.belief import Belief
from services.ground.map.overview import checksum, hyperparameters_from, kernel_parameters, reduced
from services.ground.observation import Observation
from services.mission.covariates import trend_of
from services.mission.regions import load_region
from services.mission.scenario import Scenario
from services.recorder.about import SCENARIO_RECORD
from services.recorder.reader import Recording

if TYPE_CHECKING:
    from pathlib import Path

    from schemas.ground import MapOverview, MapValues
    from schemas.telemetry import SampleReport
    from services.recorder.reader import Recorded

TOLERANCE_PPB: Final = 1e-6  # a float32 of 8 to 16 ppb has steps of 0.95e-6
# ppb, where overviews were lost: samples and fits in between are known, their order is not, and a float32 map that is
# updated in another order differs by some roundings.
TOLERANCE_AFTER_LOSS_PPB: Final = 1e-4


@dataclass(frozen=True, slots=True)
class Verification:
    """The comparison of all recorded revisions of the map with the belief rebuilt from the recorded samples."""

    revisions: int = 0
    """Revisions of the map that were compared."""
    samples: int = 0
    """Samples in the last of them."""
    values: int = 0
    """Values that were compared, of mean and standard deviation each."""
    largest_mean_ppb: float = 0.0
    """Largest difference of the mean [ppb]."""
    largest_std_ppb: float = 0.0
    """Largest difference of the standard deviation [ppb]."""
    at_revision: int = 0
    """The revision with the largest difference of the two."""
    identical: int = 0
    """Revisions whose maps are equal to the byte on all cells."""
    after_loss: int = 0
    """Revisions behind overviews that were not recorded, up to the next fit; compared apart from the others."""
    largest_after_loss_ppb: float = 0.0
    """Largest difference of mean or standard deviation in them [ppb]."""
    problems: tuple[str, ...] = ()
    """What is damaged or missing in the file, a line each: the comparison says nothing about it."""

    @property
    def largest_ppb(self) -> float:
        """Largest difference of mean or standard deviation [ppb]."""
        return max(self.largest_mean_ppb, self.largest_std_ppb)

    @property
    def equal(self) -> bool:
        """Whether no value differs by more than the tolerance that holds for it."""
        return self.largest_ppb <= TOLERANCE_PPB and self.largest_after_loss_ppb <= TOLERANCE_AFTER_LOSS_PPB


def verify(path: Path) -> Verification:
    """The comparison for that recording.

    Raises InvalidInput for a recording without overviews, He3Error, with the revision, where the belief cannot be
    rebuilt because samples or plans are missing.
    """
    evidence = Evidence(path)
    result = Verification(problems=evidence.problems)
    rebuilt: RebuiltBelief | None = None
    for overview, values in evidence.overviews():
        if rebuilt is None:
            rebuilt = RebuiltBelief(overview, evidence)
        elif overview.revision <= rebuilt.revision:
            continue  # a repetition
        rebuilt.follow(overview)
        result = _with(result, overview, values, rebuilt)
    if rebuilt is None:
        raise InvalidInput(f"{path}: expected a recording with overviews of the map ({MAP_OVERVIEW.name}), got none")
    return result


class Evidence:
    """The recorded samples and plans, read at once, and the overviews, read one by one."""

    def __init__(
        self, path: Path, region: str | None = None, keep: Callable[[Recorded], None] = lambda message: None
    ) -> None:
        """region: where the mission's region is on this machine, if it is not where the scenario says.

        keep: called with each whole message, in the order in which they were recorded.
        """
        self._path = path
        self.samples: dict[str, SampleReport] = {}
        """Every report by sample, in the order in which custody delivers them."""
        self.planned: dict[str, tuple[int, int, int]] = {}
        """Position of each sample in the order of planning: round, first plan revision that has it, index."""
        sequences: dict[str, tuple[int, int]] = {}
        recording = Recording(path)
        for message in recording.messages():
            keep(message)
            if message.topic is SAMPLE:
                self.samples.setdefault(message.body.sample_id, message.body)
                sequences.setdefault(message.body.sample_id, (message.header.incarnation, message.header.sequence))
            elif message.topic is PLAN:
                plan = message.body
                for planned in plan.rounds:
                    for index, sample in enumerate(planned.samples):
                        place = (planned.round, plan.revision, index)
                        self.planned[sample.sample_id] = min(place, self.planned.get(sample.sample_id, place))
        self.samples = {name: self.samples[name] for name in sorted(self.samples, key=sequences.__getitem__)}
        self.problems = tuple(recording.problems())
        """What is damaged or missing in the file."""
        self.scenario: Scenario | None = None
        text = recording.about.get(SCENARIO_RECORD, {}).get("json")
        try:
            self.scenario = None if text is None else Scenario.model_validate_json(text)
        except ValidationError as error:
            self.problems += (f"the scenario of the mission is damaged: {one_line(error)}",)
        if self.scenario is not None and region is not None:
            self.scenario = self.scenario.model_copy(update={"region": region})
        self.about = recording.about
        """The metadata records on the mission, by name."""

    def overviews(self) -> Iterator[tuple[MapOverview, MapValues | None]]:
        """Each overview of the map with its values, in the order in which they were recorded."""
        for message in Recording(self._path).messages():
            if message.topic is MAP_OVERVIEW:
                yield message.body, message.body.values

    def interests_at_first(self) -> tuple[InterestArea, ...]:
        """The areas of interest of the scenario, which hold until an operator changes one."""
        areas = {} if self.scenario is None else self.scenario.ground.interests
        return tuple(
            InterestArea(area_id=name, polygon_m=tuple(area.polygon_m), weight=area.weight)
            for name, area in areas.items()
        )

    def trend(self) -> CovariateTrend | None:
        """The prior mean of the belief, if the scenario has one; raises He3Error if its region is not at hand."""
        scenario = self.scenario
        if scenario is None or (scenario.ground.prior != "orbital" and not scenario.ground.covariates):
            return None
        return trend_of(scenario, load_region(scenario.region, scenario.field.field_seed))

    def observation(self, sample_id: str) -> Observation:
        """The sample as the belief takes it; raises He3Error if its report or its plan was not recorded."""
        report, planned = self.samples.get(sample_id), self.planned.get(sample_id)
        if report is None or planned is None:
            missing = "report" if report is None else "plan"
            raise He3Error(f"sample {sample_id}: expected its {missing} in the recording, got none")
        return Observation(planned, (report.x_m, report.y_m), report.helium3_ppb)


class RebuiltBelief:
    """The belief at the revision that was last followed to."""

    def __init__(self, first: MapOverview, evidence: Evidence) -> None:
        grid = SiteGrid(first.rows, first.columns, first.resolution_m)
        self._evidence = evidence
        self._fits = 0
        self.belief = Belief(grid, first.kernel.name, first.kernel.noise_std_ppb, evidence.trend())
        self.revision = 0
        self.exact = True
        """Whether every step since the last fit is known, in its order."""

    def begin_at(self, overview: MapOverview, samples: Iterable[str]) -> None:
        """Begin at a revision that was rebuilt with new hyperparameters, from these samples."""
        observed = {name: self._evidence.observation(name) for name in samples}
        self.belief.begin_with(observed, hyperparameters_from(overview.kernel))
        self._fits, self.revision = overview.fits, overview.revision

    def follow(self, overview: MapOverview) -> None:
        """Take in what led to that revision; raises He3Error if something of it was not recorded."""
        try:
            added = self._added(overview)
            for sample_id in added:
                self.belief.add(sample_id, self._evidence.observation(sample_id))
            self.exact = self.exact and overview.revision == self.revision + 1
            if overview.fits != self._fits or kernel_parameters(self.belief.hyperparameters) != overview.kernel:
                self.belief.adopt(hyperparameters_from(overview.kernel))
                self.exact = not added
        except He3Error as error:
            raise He3Error(f"revision {overview.revision} of the map cannot be rebuilt: {error}") from None
        self._fits, self.revision = overview.fits, overview.revision

    def _added(self, overview: MapOverview) -> list[str]:
        """The samples of that revision that are not in the belief yet.

        Where overviews were lost, the samples in between are the next ones in the order of their delivery.
        """
        added = [name for name in overview.added if name not in self.belief]
        lost = overview.samples - len(self.belief) - len(added)
        between = [name for name in self._evidence.samples if name not in self.belief and name not in added]
        if not 0 <= lost <= len(between):
            known = len(self.belief) + len(added) + len(between)
            raise He3Error(f"expected {overview.samples} samples in the recording, got {known}")
        return between[:lost] + added


def _with(
    result: Verification, overview: MapOverview, values: MapValues | None, rebuilt: RebuiltBelief
) -> Verification:
    """The result with that revision compared as well."""
    current = rebuilt.belief.map
    same = checksum(current.mean_ppb, current.std_ppb) == overview.checksum
    revisions = result.revisions + 1
    result = replace(result, revisions=revisions, samples=overview.samples, identical=result.identical + same)
    if values is None:
        return result
    shape = values.rows, values.columns
    mean = difference(values.mean_base64, shape, reduced(current.mean_ppb, overview.step))
    std = difference(values.std_base64, shape, reduced(current.std_ppb, overview.step))
    result = replace(result, values=result.values + values.rows * values.columns)
    if not rebuilt.exact:
        largest = max(result.largest_after_loss_ppb, mean, std)
        return replace(result, after_loss=result.after_loss + 1, largest_after_loss_ppb=largest)
    return replace(
        result,
        largest_mean_ppb=max(result.largest_mean_ppb, mean),
        largest_std_ppb=max(result.largest_std_ppb, std),
        at_revision=overview.revision if max(mean, std) > result.largest_ppb else result.at_revision,
    )


def difference(recorded_base64: str, shape: tuple[int, int], rebuilt: Float32Array) -> float:
    """Largest absolute difference [ppb] between recorded and rebuilt values; raises He3Error for another shape."""
    recorded = np.frombuffer(base64.b64decode(recorded_base64), dtype="<f4")
    if recorded.size != shape[0] * shape[1] or rebuilt.shape != shape:
        raise He3Error(f"expected recorded values of {rebuilt.shape} cells, got {recorded.size} of {shape}")
    return float(np.abs(recorded.reshape(shape).astype(np.float64) - rebuilt).max())
