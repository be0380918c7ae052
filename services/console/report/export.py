"""The map as a file of numbers, for other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from he3.frames import SiteGrid
from schemas.maps import MapLayer
from services.runtime.files.output import failed, open_output

if TYPE_CHECKING:
    from schemas.telemetry import SampleReport

EXPORTED: Final = (MapLayer.MEAN, MapLayer.STD, MapLayer.TRAVERSABLE)
"""The layers that a file holds."""


@dataclass(frozen=True, slots=True, eq=False)
class Export:
    """A map with its samples; arrays are (rows, columns), row 0 in the south."""

    mean_ppb: NDArray[Any]
    std_ppb: NDArray[Any]
    traversable: NDArray[np.bool_]
    resolution_m: float
    samples: tuple[SampleReport, ...]

    @property
    def grid(self) -> SiteGrid:
        rows, columns = self.mean_ppb.shape
        return SiteGrid(rows, columns, self.resolution_m)


def write_npz(export: Export, path: Path) -> None:
    """All layers, coordinates [m] and samples as NumPy arrays."""
    grid = export.grid
    with _writing(path), open_output(path) as stream:
        np.savez_compressed(
            stream,
            mean_ppb=export.mean_ppb,
            std_ppb=export.std_ppb,
            traversable=export.traversable,
            resolution_m=np.float64(export.resolution_m),
            x_m=grid.x_m,
            y_m=grid.y_m,
            sample_id=np.array([sample.sample_id for sample in export.samples]),
            sample_m=np.array([(s.x_m, s.y_m) for s in export.samples], dtype=np.float64).reshape(-1, 2),
            sample_ppb=np.array([sample.helium3_ppb for sample in export.samples], dtype=np.float64),
        )


def write_csv(export: Export, path: Path) -> None:
    """One line a cell: x, y [m], mean and standard deviation [ppb], traversable (0 or 1)."""
    grid = export.grid
    table = np.column_stack(
        (grid.points(), export.mean_ppb.ravel(), export.std_ppb.ravel(), export.traversable.ravel().astype(int))
    )
    with _writing(path), TextIOWrapper(open_output(path), encoding="utf-8") as stream:
        np.savetxt(
            stream,
            table,
            fmt=("%.3f", "%.3f", "%.6f", "%.6f", "%d"),
            delimiter=",",
            header="x_m,y_m,mean_ppb,std_ppb,traversable",
            comments="",
        )


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Within this context an OSError becomes a He3Error with one line."""
    try:
        yield
    except OSError as error:
        raise failed(f"{path}: cannot write the map", error) from None


WRITERS: Final[Mapping[str, Callable[[Export, Path], None]]] = {".npz": write_npz, ".csv": write_csv}
"""Functions that write a map, by the suffix of the file."""
