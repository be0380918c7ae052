"""The outputs of a mission: report, pictures, recording; checked before the mission, written after it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from he3.errors import He3Error, InvalidInput
from services.runtime.files.lock import FileLock, lock_beside
from services.runtime.files.output import failed

if TYPE_CHECKING:
    from he3.reference import Region
    from schemas.report import MissionReport
    from services.console.report.mission_report import Outcome


LOCK = ".lock"
"""Name of the lock file in a folder that belongs to one mission at a time."""


@dataclass(frozen=True, slots=True)
class Outputs:
    """Where the outputs go; None: they are not written."""

    folder: Path | None
    report: Path | None

    @property
    def recording(self) -> Path | None:
        return None if self.folder is None else self.folder / "mission.mcap"

    def wanted(self) -> tuple[Path, ...]:
        """Every file that will be written."""
        in_folder = () if self.folder is None else tuple(self.folder / name for name in ("map.png", "rmse.png"))
        return (*in_folder, *((self.report,) if self.report is not None else ()))


def outputs(folder: Path | None, report: Path | None, events: Path | None = None) -> Outputs:
    """The output paths of a mission, after a check that they can be written; nothing is created.

    Raises InvalidInput for a folder that is a file, or a place without permission to write.
    """
    if folder is not None:
        _check_writable("--out", folder)
        if folder.exists() and not folder.is_dir():
            raise InvalidInput(f"--out {folder}: expected a folder, got a file")
    for flag, file in (("--report", report), ("--events", events)):
        if file is not None:
            _check_writable(flag, file)
            if file.is_dir():
                raise InvalidInput(f"{flag} {file}: expected a file, got a folder")
    return Outputs(folder, report if report is not None or folder is None else folder / "report.json")


def _check_writable(flag: str, path: Path) -> None:
    place = path
    try:
        while not place.exists():
            place = place.parent
    except OSError as error:  # a folder on the way may not be entered
        raise failed(f"{flag} {path}: expected a place to write to", error) from None
    if place != path and not place.is_dir():
        raise InvalidInput(f"{flag} {path}: expected a folder at {place}, got a file")
    if not os.access(place, os.W_OK):
        raise InvalidInput(f"{flag} {path}: expected a place to write to, got no permission at {place}")


def make_folder(folder: Path) -> Path:
    """The folder, made if it does not exist; raises as `failed` if it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise failed(f"{folder}: cannot make the folder", error) from None
    return folder


@contextmanager
def claimed(where: Outputs, events: Path | None = None, journal: Path | None = None) -> Iterator[None]:
    """Reserve the output paths for this process, and remove files that an earlier mission left there.

    An earlier recording stays: the recorder keeps it beside the new one. journal: a folder to reserve as well. Raises
    InvalidInput if another process uses one of them, He3Error if they cannot be prepared.
    """
    with ExitStack() as held:
        if where.folder is not None:
            make_folder(where.folder)
            expected = f"--out {where.folder}: expected a folder that no other mission writes to"
            held.enter_context(FileLock(where.folder / LOCK, expected))
        for flag, path in (("--report", where.report), ("--events", events)):
            if path is not None and (path.is_file() or not path.exists()):
                expected = f"{flag} {path}: expected a file that no other mission writes"
                held.enter_context(lock_beside(path, expected))
        if journal is not None:
            make_folder(journal)
            expected = f"--journal {journal}: expected a folder that no other mission uses"
            held.enter_context(FileLock(journal / LOCK, expected))
        _remove_stale(where, events)
        yield


def _remove_stale(where: Outputs, events: Path | None) -> None:
    stale = [*where.wanted(), *(() if events is None else (events,))]
    if where.folder is not None:
        stale.append(where.folder / "report.json")
    for path in stale:
        if path.is_file():
            try:
                path.unlink()
            except OSError as error:
                raise failed(f"{path}: cannot remove what an earlier mission left", error) from None


@dataclass(frozen=True, slots=True)
class Written:
    """The outputs written for a finished mission."""

    report: MissionReport
    """The report, with a line on each output that could not be written."""
    files: tuple[Path, ...]
    """The files that were written, in order."""
    report_error: He3Error | None = None
    """Why the report itself could not be written."""


def write_outcome(
    outcome: Outcome, region: Region, where: Outputs, events: Path | None, problems: Sequence[str]
) -> Written:
    """Write the pictures and the report. A picture that cannot be written is noted in the report; it is no failure.

    events: the event log that was written. problems: one line on each output that could not be written before.
    """
    from services.console.report.mission_report import write_report

    lines = list(problems)
    pictures: list[Path] = []
    if where.folder is not None:
        for path, save_picture in _pictures(outcome, region, where.folder):
            try:
                save_picture(path)
                pictures.append(path)
            except He3Error as error:
                lines.append(str(error))
    report = outcome.report.model_copy(update={"output_problems": tuple(lines)})
    report_error = None
    if where.report is not None:
        try:
            write_report(report, where.report)
        except He3Error as error:
            report_error = error
    whole = None if any(line.startswith(f"{events}: ") for line in problems) else events
    there = [path for path in (where.recording, whole) if path is not None and path.exists()]
    written = [*([where.report] if report_error is None and where.report is not None else []), *pictures, *there]
    return Written(report, tuple(written), report_error)


def _pictures(outcome: Outcome, region: Region, folder: Path) -> Iterator[tuple[Path, Callable[[Path], None]]]:
    """Each picture's file, and what writes it."""
    import numpy as np

    from services.console.report.pictures import MapPicture, map_figure, places_and_path, rmse_figure, save

    report = outcome.report
    samples, path = places_and_path(report.sample_table, report.path_m)
    picture = MapPicture(
        title=_title(region, report),
        note=caption(report),
        reference_ppb=region.he3_ppb if region.known is None else np.where(region.known, region.he3_ppb, np.nan),
        mean_ppb=outcome.mean_ppb,
        std_ppb=outcome.std_ppb,
        traversable=region.traversable,
        resolution_m=outcome.resolution_m,
        path_m=path,
        samples_m=samples,
        start_m=tuple(path[0]) if len(path) else (0.0, 0.0),
        keep_outs_m=[area.polygon_m for area in outcome.track.keep_outs],
    )
    yield folder / "map.png", lambda path: save(map_figure(picture), path)
    title = f"Error of the map · {region.title}"
    yield folder / "rmse.png", lambda path: save(rmse_figure(title, caption(report), report.rmse_history), path)


def _title(region: Region, report: MissionReport) -> str:
    error = "" if report.rmse_ppb is None else f" · RMSE {report.rmse_ppb:.3f} ppb"
    return f"{region.title} · {report.planner} · {report.samples} samples{error} · {report.path_length_m / 1000:.1f} km"


def caption(report: MissionReport) -> str:
    """One line under a picture: what it shows, of which mission, on which data."""
    error = "" if report.rmse_ppb is None else f"RMSE {report.rmse_ppb:.4f} ppb, "
    if report.within_reach is not None:
        error = f"{error[:-2]} ({report.within_reach.rmse_ppb:.4f} ppb within the rover's reach), "
    return (
        f"{report.scenario}, seed {report.seed}, kernel {report.kernel}: {error}"
        f"{report.path_length_m:,.0f} m driven, one-way light time {report.one_way_light_time_s:g} s. "
        f"{report.region_note}"
    )
