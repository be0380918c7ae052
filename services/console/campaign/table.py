"""The rows of a store as columns: what the report computes with, and what CSV and Parquet hold."""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from he3.errors import He3Error, InvalidInput
from he3.frames import FloatArray
from services.console.campaign.statistics import distinct
from services.console.campaign.store import Row
from services.console.campaign.task import DONE, canonical
from services.runtime.files.output import failed, open_output, write_output

SCENARIO, SEED = "scenario", "seed"


@dataclass(frozen=True, slots=True)
class Kind:
    """How a figure is shown, and which of its values are bad ones."""

    title: str
    unit: str = ""
    scale: float = 1.0
    """What a value is divided by to be in that unit."""
    high_is_bad: bool = True

    def words(self, value: float) -> str:
        """The figure with its name and unit: map RMSE 0.717 ppb."""
        return f"{self.title} {value / self.scale:,.4g} {self.unit}".rstrip()


KINDS: Final = {
    "rmse_ppb": Kind("map RMSE", "ppb"),
    "rmse_within_reach_ppb": Kind("map RMSE within reach", "ppb"),
    "path_length_m": Kind("path length", "m"),
    "mission_time_s": Kind("mission time", "h", 3600.0),
    "coverage_68": Kind("coverage of 68.3 % intervals", high_is_bad=False),
    "coverage_95": Kind("coverage of 95.4 % intervals", high_is_bad=False),
    "mean_std_ppb": Kind("mean map std", "ppb"),
    "samples": Kind("samples", high_is_bad=False),
    "messages_sent": Kind("messages sent"),
    "messages_retransmitted": Kind("messages repeated"),
    "messages_lost": Kind("messages lost"),
}
"""Figures of a mission, in the order of their interest. Others are shown under their own name."""


def kind_of(figure: str) -> Kind:
    """How the figure of that name is shown."""
    return KINDS.get(figure) or Kind(figure)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The rows as columns; index i is the same mission in each."""

    keys: tuple[str, ...]
    labels: dict[str, list[Any]]
    """Scenario, seed, and the parameters of the study, each with its value in every row."""
    figures: dict[str, FloatArray]
    """(n,) numbers of the results; NaN where a row has none."""
    completed: NDArray[np.bool_]
    """(n,) whether the mission came to its end with what was asked for; False for an error, too."""
    errors: dict[int, str]
    """What went wrong, by row: an error, or why a mission was not completed."""
    settings: list[dict[str, Any]]

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def failed(self) -> NDArray[np.bool_]:
        """(n,) whether a row is an error, without any figure."""
        found: NDArray[np.bool_] = np.ones(len(self), dtype=bool)
        for column in self.figures.values():
            found &= np.isnan(column)
        return found

    def command(self, index: int) -> str:
        """The command that flies that mission again; empty for a row that is no mission.

        Every word that comes from the store is quoted: a person copies the command into a shell.
        """
        settings = self.settings[index]
        if not {SCENARIO, SEED} <= self.labels.keys() or self.labels[SCENARIO][index] is None:
            return ""
        reference, seed = str(self.labels[SCENARIO][index]), str(self.labels[SEED][index])
        words = ["he3", "run", reference, "--in-process", "--seed", seed]
        for key, value in settings.items():
            words += ["--set", f"{key}={_text(value)}"]
        if reference.startswith("-") or not all(map(str.isprintable, words)):
            return ""  # a flag in place of a scenario, or what a terminal would act on: no campaign writes that
        return shlex.join(words)

    def varied(self) -> list[str]:
        """Names of the labels that have several values."""
        return [name for name, column in self.labels.items() if len(set(map(distinct, column))) > 1]


def _text(value: Any) -> str:
    return value if isinstance(value, str) else canonical(value)


def table_of(rows: Iterable[Row]) -> Table:
    """The columns of those rows."""
    keys: list[str] = []
    labels: dict[str, list[Any]] = {}
    figures: dict[str, list[float]] = {}
    completed: list[bool] = []
    errors: dict[int, str] = {}
    settings: list[dict[str, Any]] = []
    known: dict[str, dict[str, Any]] = {}
    for index, row in enumerate(rows):
        keys.append(row.key)
        flat = {name: row.labels.get(name) for name in row.labels if name not in ("parameters", "settings")}
        flat.update(row.labels.get("parameters", {}))
        _append(labels, flat, index, None)
        result = row.result or {}
        numbers = {
            name: float(value)
            for name, value in result.items()
            if isinstance(value, (int, float)) and not isinstance(value, bool)
        }
        _append(figures, numbers, index, float("nan"))
        whole = row.status == DONE and bool(result.get("completed", True)) and _has_all_samples(result)
        completed.append(whole)
        if not whole:
            errors[index] = row.error or str(result.get("detail") or "not completed")
        chosen = dict(row.labels.get("settings", {}))
        settings.append(known.setdefault(canonical(chosen), chosen))
    return Table(
        tuple(keys),
        labels,
        {name: np.array(column) for name, column in figures.items()},
        np.array(completed, dtype=bool),
        errors,
        settings,
    )


def _has_all_samples(result: Mapping[str, Any]) -> bool:
    """Whether the mission brought the samples that were asked for, or its goal holds without them."""
    if result.get("goal_holds", False) or "samples_wanted" not in result:
        return True
    return bool(result.get("samples", 0) >= result["samples_wanted"])


def _append(columns: dict[str, list[Any]], values: dict[str, Any], index: int, missing: Any) -> None:
    """Append a row's values to the columns; a column that it lacks gets `missing`."""
    for name in values:
        if name not in columns:
            columns[name] = [missing] * index
    for name, column in columns.items():
        column.append(values.get(name, missing))


def shown_figures(table: Table, wanted: Sequence[str] = ()) -> list[str]:
    """The figures that a report is about: those wanted, else the first four that vary. Raises InvalidInput."""
    if not len(table):
        raise InvalidInput("expected one row at least in the store, got none")
    for name in wanted:
        if name not in table.figures:
            raise InvalidInput(
                f"--figures: expected some of {', '.join(sorted(table.figures)) or 'none'}, got '{name}'"
            )
    if wanted:
        return list(wanted)
    ordered = [name for name in KINDS if name in table.figures]
    ordered += [name for name in table.figures if name not in KINDS and not name.endswith("wanted")]
    return [name for name in ordered if _varies(table.figures[name])][:4]


def _varies(column: FloatArray) -> bool:
    there = column[~np.isnan(column)]
    return bool(len(there)) and bool(np.ptp(there) > 0)


def write_csv(table: Table, path: Path) -> None:
    """Write one line a row, with labels, figures and errors; raises He3Error."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["key", *table.labels, *table.figures, "completed", "error"])
    for index, key in enumerate(table.keys):
        numbers = ("" if np.isnan(column[index]) else repr(float(column[index])) for column in table.figures.values())
        words = (column[index] for column in table.labels.values())
        writer.writerow([key, *words, *numbers, bool(table.completed[index]), table.errors.get(index, "")])
    try:
        write_output(path, text.getvalue().encode())
    except OSError as error:
        raise failed(f"{path}: cannot write the rows", error) from None


def write_parquet(table: Table, path: Path) -> None:
    """Write the same as Parquet; raises He3Error, also if PyArrow is not installed."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise He3Error(
            "--parquet: expected PyArrow, which is not installed: pip install 'he3-seeker[cluster]'"
        ) from None
    columns: dict[str, Any] = {"key": list(table.keys)}
    for name, values in table.labels.items():
        kinds = {type(value) for value in values if value is not None}
        columns[name] = values if len(kinds) <= 1 else [None if value is None else _text(value) for value in values]
    columns.update(table.figures)
    columns["completed"] = table.completed
    columns["error"] = [table.errors.get(index, "") for index in range(len(table))]
    try:
        with open_output(path) as stream:
            parquet.write_table(pyarrow.table(columns), stream)
    except OSError as error:
        raise failed(f"{path}: cannot write the rows", error) from None
