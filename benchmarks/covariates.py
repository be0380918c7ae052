"""What layers from orbit are worth: the error of the map with them over that without, by field, layers and samples.

Fields: FeO of Mons Herodotus with TiO2, clinopyroxene and height, where --data has the rasters; `t1` and `t2`, another
variation for each seed, with FeO and OMAT in pixels of 59 m. `plain` is the layers as ``ground.covariates``, of whose
weights nothing is known. `relation` is the map of helium-3 that the published relation makes of FeO and OMAT, as
``ground.prior = "orbital"``; `both` is both. The same layers follow `shifted` by two of their pixels and `biased`
(1.4 times, with a tilt of one standard deviation from west to east); then layers that have nothing to do with the
field: `turned` round, a `drawn` field and white `noise`. `at most` is the ratio with weights fitted to all cells of the
true field, which is what perfectly known weights would give.

`t1` and `t2` were made by the very relation, with FeO and OMAT that vary within pixels. So `relation` shows there what
the relation is worth where it holds but for that; `gain 2`, `gain 0` and `upside down` are the same map with a contrast
that is twice too small, missing (a map that says nothing) and of the wrong sign.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from benchmarks import kept
from benchmarks.covariate_layers import FIELDS, HERODOTUS, Survey, expect_layers, has_layers, survey_of
from benchmarks.exam_patterns import at_random, hexagonal, moved_onto
from benchmarks.tasks import Tasks, progress
from he3.errors import InvalidInput
from he3.frames import FloatArray
from he3.hyperprior import MEAN_PPB, MEAN_STD_PPB
from he3.measurement import sample_noise
from he3.trend import UNSURE_GAIN_STD, CovariateTrend, covariate_trend, orbital_trend, split_by_scale
from services.ground.belief import Belief
from services.ground.fitting import fit
from services.ground.observation import Observation

PATTERNS = ("lattice", "random")
SAMPLES = (10, 20, 30, 60, 150)
MOST_CELLS = 10_000
"""Of the grid on which a map is computed; all cells are scored."""
BIAS = 1.4
JITTER = 0.25
"""Share of the mean spacing by which each seed moves the lattice at most."""
RESAMPLES = 2000
"""Of the seeds, for the interval of a mean ratio."""

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Asked:
    """One set of samples, to which all layers are given."""

    field: str
    data: Path | None
    pattern: str
    samples: int
    seed: int

    @property
    def identity(self) -> tuple[Any, ...]:
        return self.field, self.pattern, self.samples, self.seed


def run(
    data: Path | None = None,
    fields: Sequence[str] = (),
    samples: Sequence[int] = SAMPLES,
    patterns: Sequence[str] = PATTERNS,
    seeds: int = 6,
    first: int = 101,
    kernel: str = "auto",
    jobs: int = 1,
    json: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row for each field, pattern, number of samples, seed and kind of layers; a table of mean ratios is printed.

    data: folder with the rasters of Mons Herodotus, which is left out without them; fields: some of ``FIELDS``;
    patterns: some of ``PATTERNS``; first: the first of so many seeds, each of which is another variation of `t1` and
    `t2`, other noise and other places. Rows are added to `json` as they come; what the file has is not computed again.
    Raises InvalidInput for names and numbers that do not fit, and for a file of anything else.
    """
    if data is not None and (HERODOTUS in fields or not fields):
        expect_layers(data)
    known = [name for name in FIELDS if name != HERODOTUS or has_layers(data)]
    chosen = list(fields) or known
    for given, among in ((chosen, known), (patterns, PATTERNS)):
        if unknown := [name for name in given if name not in among]:
            raise InvalidInput(f"expected names among {', '.join(among)}; got {', '.join(unknown)}")
    if not samples or min(samples) < 2 or seeds < 1 or first < 0 or not patterns:
        raise InvalidInput(
            "expected 2 samples or more, one seed and one pattern at least, and a first seed of 0 or more; got samples "
            f"{', '.join(map(str, samples)) or 'none'}, {seeds} seeds from {first} on, {len(patterns)} patterns"
        )
    if HERODOTUS not in chosen:
        say("herodotus-feo is left out: it takes --data DIR with its rasters")
    document = kept.read(json, "rows")
    rows: list[Row] = document["rows"]
    asked = [
        Asked(name, data, pattern, count, seed)
        for seed in range(first, first + seeds) for count in samples for name in chosen for pattern in patterns
    ]  # fmt: skip
    have = {_identity(row) for row in rows}
    left = [each for each in asked if (*each.identity, kernel) not in have]
    began = time.monotonic()
    with Tasks(jobs) as pool:
        for done, (_, found) in enumerate(pool.results(ratios, [(each, kernel) for each in left]), 1):
            rows += found
            kept.write(json, document)
            progress(f"  {done:>3}/{len(left)} sets of samples   ({time.monotonic() - began:.0f} s)")
        wanted = {(*each.identity, kernel) for each in asked}
        mine = [row for row in rows if _identity(row) in wanted]
        for line in table(mine):
            say(line)
    return mine


def _identity(row: Row) -> tuple[Any, ...]:
    return row["field"], row["pattern"], row["samples"], row["seed"], row["kernel"]


def ratios(task: tuple[Asked, str]) -> list[Row]:
    """A row for each kind of layers: the RMSE [ppb] with them, without, and the ratio of both."""
    asked, kernel = task
    survey = survey_of(asked.field, asked.data, asked.seed)
    places = _places(asked, survey)
    cells = survey.region.grid.cells_of(places)
    noise = [sample_noise(asked.seed, f"{i}", survey.noise_std_ppb) for i in range(asked.samples)]
    values = survey.region.he3_ppb[cells] + noise

    def error(trend: CovariateTrend | None, known: FloatArray | float = 0.0) -> float:
        """RMSE [ppb] of the map; known: (rows, columns) what is known of the field before, and subtracted."""
        grid, part = survey.region.grid, np.broadcast_to(known, survey.region.grid.shape)
        belief = Belief(grid, kernel, survey.noise_std_ppb, trend, most_cells=MOST_CELLS, followed=False)
        for number, (place, value) in enumerate(zip(places, values - part[cells], strict=True)):
            belief.add(f"{number}", Observation((1, 1, number), (float(place[0]), float(place[1])), float(value)))
        request = belief.fit_request(1, (asked.seed,))
        assert request is not None
        belief.adopt(fit(request))
        misfit = (belief.map.mean_ppb + part - survey.region.he3_ppb)[survey.known]
        return float(np.sqrt(np.mean(misfit**2)))

    without = error(None)
    found = [
        ("at most" if name == "plain" else f"{name}, at most", error(None, _fitted(layers, survey)))
        for name, layers in _bounds(survey, asked.samples)
    ]
    found += [(name, error(trend)) for name, trend in kinds(survey, asked.samples, asked.seed)]
    return [
        {
            "field": asked.field, "pattern": asked.pattern, "samples": asked.samples, "seed": asked.seed,
            "kernel": kernel, "layers": name, "rmse_ppb": rmse, "without_ppb": without, "ratio": rmse / without,
        }
        for name, rmse in found
    ]  # fmt: skip


def kinds(survey: Survey, samples: int, seed: int) -> Iterator[tuple[str, CovariateTrend]]:
    """The name of each kind of layers, and the trend that a mission of so many samples makes of it."""
    grid, rng = survey.region.grid, np.random.default_rng(np.random.SeedSequence([seed, 0xC0FA]))
    drawn = ndimage.gaussian_filter(rng.standard_normal(grid.shape), grid.extent_m / grid.resolution_m / 12)

    def plain(layers: FloatArray) -> CovariateTrend:
        return covariate_trend(grid, split_by_scale(layers, grid, samples), MEAN_PPB, MEAN_STD_PPB, split=True)

    yield "plain", plain(survey.layers)
    yield "plain, shifted", plain(survey.shifted_layers)
    yield "plain, biased", plain(np.array([biased(layer) for layer in survey.layers]))
    yield "plain, turned", plain(survey.layers[:, ::-1, ::-1])
    yield "plain, drawn", plain(drawn[None])
    yield "plain, noise", plain(rng.standard_normal((1, *grid.shape)))
    if survey.relation_ppb is None or survey.shifted_relation_ppb is None:
        return
    orbital = survey.relation_ppb
    mean = orbital.mean()

    def believed(view: FloatArray, layers: FloatArray | None = None) -> CovariateTrend:
        return orbital_trend(grid, view, UNSURE_GAIN_STD, covariates=layers)

    yield "relation", believed(orbital)
    yield "both", believed(orbital, split_by_scale(survey.layers, grid, samples))
    yield "relation, shifted", believed(survey.shifted_relation_ppb)
    yield "relation, biased", believed(biased(orbital))
    yield "relation, gain 2", believed(mean + (orbital - mean) / 2.0)
    yield "relation, turned", believed(orbital[::-1, ::-1])
    yield "relation, upside down", believed(2.0 * mean - orbital)
    yield "relation, gain 0", believed(np.full(grid.shape, mean))


def biased(layer: FloatArray) -> FloatArray:
    """The layer (rows, columns) ``BIAS`` times, with a tilt from west to east of one of its standard deviations."""
    tilt = np.linspace(-0.5, 0.5, layer.shape[1]) * float(layer.std())
    wrong: FloatArray = BIAS * layer + tilt
    return wrong


def _bounds(survey: Survey, samples: int) -> Iterator[tuple[str, FloatArray]]:
    yield "plain", split_by_scale(survey.layers, survey.region.grid, samples)
    if survey.relation_ppb is not None:
        yield "relation", survey.relation_ppb[None]


def _fitted(layers: FloatArray, survey: Survey) -> FloatArray:
    """What the layers (k, rows, columns) say of the field [ppb], with the weights of least squares over all cells."""
    columns = (layers - layers.mean(axis=(1, 2), keepdims=True))[:, survey.known].T
    truth = survey.region.he3_ppb[survey.known]
    weights = np.linalg.lstsq(columns, truth - truth.mean(), rcond=None)[0]
    found: FloatArray = np.tensordot(weights, layers - layers.mean(axis=(1, 2), keepdims=True), 1)
    return found


def _places(asked: Asked, survey: Survey) -> FloatArray:
    """(samples, 2) [m]: a hexagonal lattice, moved a little by the seed; or anywhere on open ground."""
    grid, ground = survey.region.grid, survey.region.traversable
    if asked.pattern == "random":
        return at_random(asked.samples, grid, ground, (grid.width_m / 2, grid.height_m / 2), asked.seed)
    spacing_m = np.sqrt(grid.width_m * grid.height_m / asked.samples)
    rng = np.random.default_rng(np.random.SeedSequence([asked.seed, 0x1A77]))
    moved = hexagonal(asked.samples, grid.width_m, grid.height_m) + rng.uniform(-JITTER, JITTER, 2) * spacing_m
    return moved_onto(moved, grid, ground)


def table(rows: Sequence[Row]) -> list[str]:
    """Lines with the mean ratio by field, pattern, layers and samples, and its interval of 95 % over the seeds."""
    if not rows:
        return []
    counts = sorted({row["samples"] for row in rows})
    lines = []
    fields, patterns, layers = (list(dict.fromkeys(row[key] for row in rows)) for key in ("field", "pattern", "layers"))
    for field, pattern in product(fields, patterns):
        group = [row for row in rows if (row["field"], row["pattern"]) == (field, pattern)]
        if not group:
            continue
        head = f"{'RMSE with layers / without':<27}" + "".join(f"{count:>20}" for count in counts)
        lines += [f"{field}, {pattern} places, {len({row['seed'] for row in group})} seeds", head, "-" * len(head)]
        for name in layers:
            cells = [
                _cell([row["ratio"] for row in group if (row["layers"], row["samples"]) == (name, n)]) for n in counts
            ]
            if any(cell != "-" for cell in cells):
                lines.append(f"{name:<27}" + "".join(f"{cell:>20}" for cell in cells))
        lines.append("")
    return [*lines, "in brackets: interval of 95 % of the mean, over resampled seeds; columns: samples"]


def _cell(found: Sequence[float]) -> str:
    if not found:
        return "-"
    if len(found) == 1:
        return f"{found[0]:.3f}"  # of one seed there is no spread
    low, high = interval(found)
    return f"{np.mean(found):.3f} ({low:.2f}-{high:.2f})"


def interval(found: Sequence[float]) -> tuple[float, float]:
    """The central 95 % of the mean when the seeds are drawn again with replacement."""
    values = np.asarray(found)
    picks = np.random.default_rng(1).integers(len(values), size=(RESAMPLES, len(values)))
    low, high = np.quantile(values[picks].mean(axis=1), (0.025, 0.975))
    return float(low), float(high)
