"""Planners and maps, ours and others', on third-party fields: error, density, coverage and metres.

Every method surveys the same fields with the same number of samples, noise and start, and is scored on all cells of the
true field: RMSE in units of the field's standard deviation, negative log predictive density, CRPS, coverage of the
50, 68 and 95 % intervals, and the metres driven. docs/exam.md tells where the fields come from and how the peers are
installed; a peer that is not installed is named in the table, without figures.

    he3 bench exam --data DIR --seeds 3 --fields walker-v,t1 --json exam.json --picture exam.png

Results are kept in the JSON file as they come. The same command goes on where an interrupted one stopped, and more
seeds, fields or methods are added to what is there. A method that another one needs is flown and kept, too.

`tour-matched` flies `tour` again. Its budget is what `sgptools` drove, so it never has more metres than that:

    he3 bench exam --data DIR --methods tour,tour-matched,tour-matched+sklearn,sgptools --seeds 3 --json exam.json
"""

from __future__ import annotations

import json as json_format
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from benchmarks import kept
from benchmarks.exam_comparison import comparisons
from benchmarks.exam_fields import ExamField, load_field, names_in
from benchmarks.exam_methods import METHODS, Asked, Settings, Survey, with_needed, with_our_map
from benchmarks.exam_scores import mean_and_interval, scores
from benchmarks.flights import conditions, expect_open
from benchmarks.missions import SAMPLES_A_ROUND
from benchmarks.peer_environments import PeerEnvironment
from benchmarks.tasks import Tasks, progress
from he3.errors import He3Error, InvalidInput
from he3.kernels import AUTO, KERNELS
from services.console.campaign.identity import checksum_of

Row = dict[str, Any]
Key = tuple[str, str, int]
"""Field, method and seed of a row."""

OURS = "+ours"
"""Ending of a peer's row whose samples are scored with our map."""
SCORES = ("nrmse", "nlpd", "crps", "coverage_50", "coverage_68", "coverage_95")
FORMAT = "he3-exam 1"


def run(
    data: Path | None = None,
    fields: Sequence[str] = (),
    methods: Sequence[str] = tuple(METHODS),
    seeds: int = 3,
    samples: int = 150,
    noise: float | None = None,
    start: Sequence[float] = (),
    budget: float | None = None,
    kernel: str = AUTO,
    hyperparameters: Literal["ml", "bayes"] = "bayes",
    jobs: int = 1,
    engine: str = "local",
    store: Path | None = None,
    json: Path | None = None,
    picture: Path | None = None,
    *,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row a survey; the tables printed, rows kept in `json`, a picture drawn.

    data: folder with rasters (docs/exam.md); without it, our own regions alone. fields: all that there are if empty.
    noise: standard deviation as a share of the field's; the field's own if None. start: X,Y [m]. budget: metres.
    kernel and hyperparameters: of our planners and our map. engine, store: as `he3 campaign run` takes
    them. Raises InvalidInput for names and numbers that do not fit; He3Error, after the tables, if a survey failed.
    """
    settings = _settings(samples, start, budget, kernel, hyperparameters)
    if seeds < 1:
        raise InvalidInput(f"expected one seed at least, got {seeds}")
    unknown = [name for name in methods if name not in METHODS]
    if unknown or not methods:
        raise InvalidInput(f"expected methods among {', '.join(METHODS)}; got {', '.join(unknown) or 'none'}")
    names = list(fields) or names_in(data)
    sums = {}
    for name in names:
        region = load_field(name, data, noise).region
        expect_open(region, settings.start_m)
        sums[name] = checksum_of(region)
    missing = [name for name in methods if not _installed(name)]
    flown = [name for name in METHODS if name in methods and name not in missing]
    if not flown:
        for peer in _peers_of(missing):
            peer.python()  # says what is missing, and how it is installed
    kept = Kept(json, {**asdict(settings), "noise": noise}, sums)
    tasks = [Task(name, data, noise, settings, seed, tuple(flown), kept.of(name, seed))
             for seed in range(1, seeds + 1) for name in names]  # fmt: skip
    failures: list[str] = []
    began = time.monotonic()
    with Tasks(jobs, engine, store) as pool:
        for _, row in pool.items(surveys, tasks):
            head = f"  {row['field']:<16} {row['method']:<22} seed {row['seed']:<3}"
            if "failed" in row:
                failures.append(f"{row['method']} on {row['field']}, seed {row['seed']}: {row['failed']}")
                progress(f"{head} failed: {row['failed']}")
                continue
            kept.add(row)
            progress(f"{head} nrmse {row['nrmse']:.3f}  nlpd {row['nlpd']:6.2f}  {row['metres']:8.0f} m  "
                     f"{row['seconds']:.0f} s   ({time.monotonic() - began:.0f} s)")  # fmt: skip
        rows = kept.chosen(names, flown, seeds)
        for line in report(rows, names, missing):
            say(line)
        if pool.stopped is not None:
            say(f"stopped by {pool.stopped.name}: {len(rows)} surveys so far; the same command goes on from here")
    if picture is not None and rows:
        from benchmarks.exam_picture import draw

        say(f"written {draw(rows, names, picture)}")
    if failures:
        raise He3Error(f"{len(failures)} of the surveys failed, the first: {failures[0]}")
    return rows


def _installed(name: str) -> bool:
    """Whether there is the software that a method needs, and the methods before it."""
    return all(peer.installed for peer in _peers_of([name]))


def _peers_of(methods: Sequence[str]) -> list[PeerEnvironment]:
    """The environments that methods need, and the methods before them."""
    return [peer for each in with_needed(methods) if (peer := METHODS[each].peer) is not None]


def _settings(samples: int, start: Sequence[float], budget: float | None, kernel: str, belief: str) -> Settings:
    if samples < SAMPLES_A_ROUND or samples % SAMPLES_A_ROUND:
        raise InvalidInput(f"expected samples in rounds of {SAMPLES_A_ROUND}, got {samples}")
    if kernel not in (*KERNELS, AUTO):
        raise InvalidInput(f"expected a kernel among {', '.join((*KERNELS, AUTO))}; got {kernel!r}")
    shared = conditions(0.0, start, budget)
    return Settings(samples, kernel, belief == "ml", shared.budget_m, shared.start_m)


# --- surveys ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Task:
    """All surveys of one field with one seed; known: the rows that there are already."""

    name: str
    data: Path | None
    noise: float | None
    settings: Settings
    seed: int
    methods: tuple[str, ...]
    known: tuple[Row, ...]


@cache
def _loaded(name: str, data: Path | None, noise: float | None) -> ExamField:
    return load_field(name, data, noise)


def surveys(task: Task) -> Iterator[Row]:
    """A row for each survey that is not known yet, as soon as it is flown; one with the key `failed` if it failed."""
    field = _loaded(task.name, task.data, task.noise)
    known = {row["method"]: row for row in task.known}
    before = {name: _remembered(row) for name, row in known.items()}
    for name in _missing(task, known):
        method = METHODS[name]
        if method.open_ground and not field.region.traversable.all():
            continue
        if method.after is not None and method.after not in before:
            continue  # that one failed
        asked = Asked(field, task.settings, task.seed, before)
        try:
            survey = method.fly(asked)
            before.setdefault(name, survey)
            if name not in known:
                yield _row(asked, name, survey)
            if method.peer is not None and name in task.methods:
                yield _row(asked, name + OURS, with_our_map(asked, survey))
        except He3Error as error:
            yield {"field": task.name, "method": name, "seed": task.seed, "failed": str(error)}


def _missing(task: Task, known: Mapping[str, Row]) -> list[str]:
    """The methods that are to be flown: those that lack a row, of a peer also that with our map, and what they need."""
    rows = {name: [name] if METHODS[name].peer is None else [name, name + OURS] for name in task.methods}
    lacking = [name for name, wanted in rows.items() if not known.keys() >= set(wanted)]
    return [name for name in with_needed(lacking) if name in lacking or name not in known]


def _row(asked: Asked, name: str, survey: Survey) -> Row:
    field = asked.field
    score = scores(field.region.he3_ppb, survey.mean_ppb, survey.std_ppb, field.known)
    row = {
        "field": field.name, "method": name, "seed": asked.seed, "nrmse": score.nrmse,
        "nlpd": score.nlpd, "crps": score.crps, "coverage_50": score.coverage_50,
        "coverage_68": score.coverage_68, "coverage_95": score.coverage_95, "metres": survey.metres,
        "samples": len(survey.places_m), "seconds": survey.seconds, "note": survey.note,
    }  # fmt: skip
    if name in {method.after for method in METHODS.values()}:  # what they need, when the exam is continued
        row |= {"places_m": survey.places_m.tolist(), "values_ppb": survey.values_ppb.tolist()}
    return row


def _remembered(row: Row) -> Survey:
    """The survey of a row, without its map; without its samples if no method needs them."""
    places, values = np.array(row.get("places_m", [])).reshape(-1, 2), np.array(row.get("values_ppb", []))
    return Survey(places, values, row["metres"], np.zeros((0, 0)), np.zeros((0, 0)), 0.0)


class Kept:
    """The rows of an exam in its JSON file, which is written after each."""

    def __init__(self, path: Path | None, settings: dict[str, Any], sums: Mapping[str, str] = MappingProxyType({})):
        """sums: checksum of the values of each field, by name.

        Raises InvalidInput for a file that is no exam, or one with other settings, or of fields with other values.
        """
        self._path = path
        self._settings = json_format.loads(json_format.dumps(_finite(settings)))
        self._rows: dict[Key, Row] = {}
        self._fields: dict[str, Any] = {"fields": dict(sums)}
        if path is None or not path.exists():
            return
        try:
            document = json_format.loads(path.read_text(encoding="utf-8"))
            found, settings_there = document["format"], document["settings"]
            self._rows = {(row["field"], row["method"], row["seed"]): row for row in document["rows"]}
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidInput(f"{path}: expected results of an exam, got a file without them ({error!r})") from None
        other = {key for key in self._settings if settings_there.get(key) != self._settings[key]}
        if found != FORMAT or other:
            at = ", ".join(f"{key} {settings_there.get(key)}" for key in sorted(other)) or found
            raise InvalidInput(f"{path}: expected results of the same settings, got {at}; name another file")
        self._fields = {"fields": document.get("fields", {})}
        kept.expect_fields(path, self._fields, sums)

    def of(self, field: str, seed: int) -> tuple[Row, ...]:
        """The rows of a field and a seed."""
        return tuple(row for (name, _, number), row in self._rows.items() if (name, number) == (field, seed))

    def add(self, row: Row) -> None:
        """Keep a row, on disk too; the file is replaced as a whole, so that an interruption does not damage it."""
        self._rows[row["field"], row["method"], row["seed"]] = row
        if self._path is not None:
            document = {"format": FORMAT, "settings": self._settings, **self._fields, "rows": list(self._rows.values())}
            kept.write(self._path, document)

    def chosen(self, fields: Sequence[str], methods: Sequence[str], seeds: int) -> list[Row]:
        """The rows that were asked for, by field, method and seed."""
        wanted = [name + ending for name in methods for ending in ("", OURS)]
        keys = [(field, name, seed) for field in fields for name in wanted for seed in range(1, seeds + 1)]
        return [self._rows[key] for key in keys if key in self._rows]


def _finite(settings: dict[str, Any]) -> dict[str, Any]:
    return {key: None if value == math.inf else value for key, value in settings.items()}


# --- tables -------------------------------------------------------------------------------------------------------


def report(rows: Sequence[Row], fields: Sequence[str], missing: Sequence[str]) -> list[str]:
    """Lines: a table for each field, one of means over the fields that all its methods have, and what is missing."""
    lines: list[str] = []
    for field in fields:
        of_field = [row for row in rows if row["field"] == field]
        if of_field:
            lines += [*table(of_field, field), *(f"{name:<24} not installed (docs/exam.md)" for name in missing), ""]
    if len({row["field"] for row in rows}) > 1:
        lines += [*means(rows), ""]
    lines += comparisons(rows)
    lines.append(
        "nrmse, crps: in standard deviations of the field; nlpd: nats, of the field in that unit; "
        "+-: 95 % interval of the mean over seeds; +ours: the same samples with our map"
    )
    return lines


def table(rows: Sequence[Row], title: str) -> list[str]:
    """Lines of one field: a method a line, means over seeds."""
    head = (
        f"{'method':<24} {'nrmse':>15} {'nlpd':>14} {'crps':>7} {'50 %':>6} {'68 %':>6} {'95 %':>6} {'metres':>9} "
        f"{'samples':>7} {'seeds':>5}"
    )
    lines = [title, head, "-" * len(head)]
    for method in dict.fromkeys(row["method"] for row in rows):
        of_method = [row for row in rows if row["method"] == method]
        nrmse, nlpd = (
            _with_interval([row[key] for row in of_method], width) for key, width in (("nrmse", 3), ("nlpd", 2))
        )
        mean = {key: float(np.mean([row[key] for row in of_method])) for key in (*SCORES, "metres", "samples")}
        lines.append(
            f"{method:<24} {nrmse:>15} {nlpd:>14} {mean['crps']:7.3f} {mean['coverage_50']:6.1%} "
            f"{mean['coverage_68']:6.1%} {mean['coverage_95']:6.1%} {mean['metres']:9.0f} {mean['samples']:7.0f} "
            f"{len(of_method):>5}"
        )
    return lines


def means(rows: Sequence[Row]) -> list[str]:
    """Lines of the means over fields. A method that lacks a field is compared with `tour` on those that it has."""
    by: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        by.setdefault((row["method"], row["field"]), []).append(row)
    head = (
        f"{'means over fields':<24} {'nrmse':>7} {'/ tour':>7} {'nlpd':>7} {'crps':>7} {'50 %':>6} {'68 %':>6} "
        f"{'95 %':>6} {'m / tour':>9} {'fields':>6}"
    )
    lines = [head, "-" * len(head)]
    for method in dict.fromkeys(row["method"] for row in rows):
        fields = [field for name, field in by if name == method]
        mean = {key: float(np.mean([_mean(by[method, field], key) for field in fields])) for key in SCORES}
        with_tour = [field for field in fields if ("tour", field) in by]
        ratios = [[_mean(by[method, field], key) / _mean(by["tour", field], key) for field in with_tour]
                  for key in ("nrmse", "metres")]  # fmt: skip
        shown = [f"{np.mean(each):.3f}" if each else "-" for each in ratios]
        lines.append(
            f"{method:<24} {mean['nrmse']:7.3f} {shown[0]:>7} {mean['nlpd']:7.2f} {mean['crps']:7.3f} "
            f"{mean['coverage_50']:6.1%} {mean['coverage_68']:6.1%} {mean['coverage_95']:6.1%} {shown[1]:>9} "
            f"{len(fields):>6}"
        )
    return lines


def _mean(rows: Sequence[Row], key: str) -> float:
    return float(np.mean([row[key] for row in rows]))


def _with_interval(values: Sequence[float], digits: int) -> str:
    mean, half = mean_and_interval(values)
    return f"{mean:.{digits}f}" if math.isnan(half) else f"{mean:.{digits}f} +- {half:.{digits}f}"
