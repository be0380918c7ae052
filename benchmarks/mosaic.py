"""A window of 1 km out of a mosaic of 3 GB: how long a region takes to build, and how much memory.

The mosaic is sparse: it has its length and one block around the window, with an analytic field. The region is built by
`he3 region build` in a process of its own, whose time includes the start of Python and the writing of all layers.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from benchmarks import kept
from he3.constants import MOON_RADIUS_M
from he3.errors import He3Error
from he3.frames import FloatArray
from services.mission.region_build.geo import rasterio
from services.mission.regions import load_region

Row = dict[str, Any]

_PER_DEGREE: Final = 512  # as the mosaics of Kaguya MI and SLDEM2015
_ROWS, _COLUMNS, _NORTH, _WEST = 5120, 160_000, 25.0, -150.0
_PIXELS: Final = 96  # of the part that has values
_LAT, _LON = 20.19, 30.772
_RECIPE: Final = f"""format = "he3-region-recipe"
version = 1
name = "window"
title = "1 km of a mosaic"
centre_lat_deg = {_LAT}
centre_lon_deg = {_LON}
rows = 1000
columns = 1000
[chemistry]
lay_over = "t1"
[layers.elevation_m]
file = "mosaic.tif"
source = "analytic"
"""


# The system's own figure for a finished child counts the memory of the process that started it, too.
_BUILD: Final = """
import pathlib, re, sys
from services.console.__main__ import main
code = main(sys.argv[1:])
status = pathlib.Path("/proc/self/status").read_text()
pathlib.Path("peak").write_text(re.search(r"VmHWM:\\s+(\\d+) kB", status)[1])
sys.exit(code)
"""


def run(json: Path | None = None, *, say: Callable[[str], None] = print) -> Row:
    """Seconds, peak memory and the largest error of the heights; one line printed, the row written to `json`.

    Raises He3Error if the region cannot be built.
    """
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        _write_mosaic(folder / "mosaic.tif")
        (folder / "window.toml").write_text(_RECIPE)
        began = time.monotonic()
        command = [sys.executable, "-c", _BUILD, "region", "build", "window.toml", "--out", "window"]
        path = os.pathsep.join(filter(None, [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]))
        with (folder / "log").open("w") as log:
            process = subprocess.Popen(
                command, cwd=folder, stdout=log, stderr=log, env={**os.environ, "PYTHONPATH": path}
            )
            _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        seconds = time.monotonic() - began
        if process.returncode != 0:
            raise He3Error(f"the region could not be built: {(folder / 'log').read_text().strip()}")
        peak_bytes = 1024 * int((folder / "peak").read_text())
        region = load_region(folder / "window")
        assert region.origin_lat_deg is not None  # it was built around a centre
        assert region.origin_lon_deg is not None
        stretch = math.cos(math.radians(_LAT))
        truth = _field(
            region.origin_lat_deg + np.degrees(region.grid.y_m / MOON_RADIUS_M)[:, None],
            region.origin_lon_deg + np.degrees(region.grid.x_m / (MOON_RADIUS_M * stretch))[None, :],
        )
        row: Row = {
            "mosaic_bytes": (folder / "mosaic.tif").stat().st_size, "cells": region.grid.rows * region.grid.columns,
            "wall_s": seconds, "processor_s": used.ru_utime + used.ru_stime, "peak_mb": peak_bytes / 1e6,
            "largest_error_m": float(np.abs(region.elevation_m - truth).max()),
        }  # fmt: skip
    say(
        f"{row['cells']:,} cells of 1 m out of {row['mosaic_bytes'] / 1e9:.2f} GB: {row['wall_s']:.2f} s "
        f"({row['processor_s']:.2f} s of processor time), {row['peak_mb']:.0f} MB at most, "
        f"heights within {row['largest_error_m'] * 100:.2f} cm of the field"
    )
    kept.write_whole(json, row)
    return row


def _field(latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
    """Heights [m], smooth over some hundred metres."""
    k = MOON_RADIUS_M / 150.0
    field: FloatArray = -1500 + 8 * np.sin(k * np.radians(latitude_deg)) + 9 * np.cos(k * np.radians(longitude_deg))
    return field


def _write_mosaic(path: Path) -> None:
    """As large as a whole mosaic of float32, without its bytes on the disk."""
    library = rasterio()
    row, column = int((_NORTH - _LAT) * _PER_DEGREE) - _PIXELS // 2, int((_LON - _WEST) * _PER_DEGREE) - _PIXELS // 2
    steps = (np.arange(_PIXELS) + 0.5) / _PER_DEGREE
    latitudes, longitudes = _NORTH - row / _PER_DEGREE - steps, _WEST + column / _PER_DEGREE + steps
    transform = library.Affine(1 / _PER_DEGREE, 0.0, _WEST, 0.0, -1 / _PER_DEGREE, _NORTH)
    with library.open(
        path, "w", driver="GTiff", height=_ROWS, width=_COLUMNS, count=1, dtype="float32", crs="IAU_2015:30100",
        transform=transform, nodata=-3.4028226550889045e38, tiled=True, sparse_ok=True, bigtiff="yes",
    ) as target:  # fmt: skip
        values = _field(latitudes[:, None], longitudes[None, :]).astype("float32")
        target.write(values, 1, window=((row, row + _PIXELS), (column, column + _PIXELS)))
    with path.open("r+b") as stream:
        stream.truncate(_ROWS * _COLUMNS * 4)
