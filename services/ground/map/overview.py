"""The overview of a new revision of the map: small enough to be published and recorded with every change."""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from he3.errors import InvalidInput
from he3.hyperparameters import Hyperparameters
from he3.kernels import kernel_from
from he3.local_amplitude import site_kernel_from
from he3.trend import UnknownConstant, UnknownLevel, unknown_level
from he3.warping import Warp
from schemas.ground import (
    MAX_OVERVIEW_CELLS,
    MAX_OVERVIEW_CORNERS,
    FieldWarp,
    KeepOutArea,
    KernelParameters,
    MapOverview,
    MapValues,
    WeightedKernel,
)

if TYPE_CHECKING:
    from he3.frames import IntArray
    from services.ground.map.snapshot import MapSnapshot


def overview(snapshot: MapSnapshot, known: int, fits: int) -> MapOverview:
    """The overview of that snapshot. known: samples in the revision before. fits: changes of hyperparameters so far.

    Raises InvalidInput for a snapshot without the belief that it was made from.
    """
    if snapshot.process is None:
        raise InvalidInput("overview: expected a map with its belief, got none")
    rows, columns = snapshot.grid.shape
    step = step_for(rows, columns)
    lat, lon = snapshot.origin_deg or (None, None)
    return MapOverview(
        revision=snapshot.revision,
        samples=len(snapshot.samples),
        added=tuple(report.sample_id for report in snapshot.samples[known:]),
        fits=fits,
        mission_time_ns=snapshot.mission_time_ns,
        kernel=kernel_parameters(snapshot.process.hyperparameters),
        rows=rows,
        columns=columns,
        resolution_m=snapshot.grid.resolution_m,
        origin_lat_deg=lat,
        origin_lon_deg=lon,
        checksum=checksum(snapshot.mean_ppb, snapshot.std_ppb),
        step=step,
        values=MapValues(
            rows=len(middles(rows, step)),
            columns=len(middles(columns, step)),
            mean_base64=_base64(reduced(snapshot.mean_ppb, step).astype("<f4")),
            std_base64=_base64(reduced(snapshot.std_ppb, step).astype("<f4")),
            traversable_base64=_base64(reduced(snapshot.traversable, step).astype(np.uint8)),
        ),
        keep_outs=_within_bounds(snapshot.keep_outs),
    )


def kernel_parameters(hyperparameters: Hyperparameters) -> KernelParameters:
    """The hyperparameters as operators see them."""
    trend = hyperparameters.trend
    noises = hyperparameters.noises_ppb or (None,) * len(hyperparameters.alternatives)
    warps = hyperparameters.warps or (None,) * len(hyperparameters.alternatives)
    return KernelParameters(
        mean_std_ppb=trend.std_ppb if isinstance(trend, UnknownConstant | UnknownLevel) else None,
        level_extent_m=trend.extent_m if isinstance(trend, UnknownLevel) else None,
        trend_shares=hyperparameters.trend_shares or None,
        name=hyperparameters.kernel.name,
        parameters=hyperparameters.kernel.parameters(),
        noise_std_ppb=hyperparameters.noise_std_ppb,
        mean_ppb=hyperparameters.mean_ppb,
        scale_ppb=hyperparameters.scale_ppb,
        alternatives=tuple(
            WeightedKernel(
                weight=weight,
                name=None if kernel.name == hyperparameters.kernel.name else kernel.name,
                parameters=kernel.parameters(),
                noise_std_ppb=noise,
                warp=None if warp is None else FieldWarp(**asdict(warp)),
            )
            for (weight, kernel), noise, warp in zip(hyperparameters.alternatives, noises, warps, strict=True)
        )
        or None,
    )


def hyperparameters_from(kernel: KernelParameters) -> Hyperparameters:
    """The hyperparameters that operators saw, as ``kernel_parameters`` gave them; without an orbital trend."""
    alternatives = kernel.alternatives or ()
    warps = tuple(None if each.warp is None else Warp(**each.warp.model_dump()) for each in alternatives)
    return Hyperparameters(
        kernel_from(kernel.name, kernel.parameters),
        kernel.noise_std_ppb,
        kernel.mean_ppb,
        kernel.scale_ppb,
        trend=None if kernel.mean_std_ppb is None else unknown_level(kernel.mean_std_ppb, kernel.level_extent_m or 0.0),
        alternatives=tuple(
            (each.weight, site_kernel_from(each.name or kernel.name, each.parameters)) for each in alternatives
        ),
        noises_ppb=tuple(each.noise_std_ppb for each in alternatives if each.noise_std_ppb is not None),
        trend_shares=kernel.trend_shares or (),
        warps=warps if any(warps) else (),
    )


def step_for(rows: int, columns: int) -> int:
    """The smallest step with which a map of that shape has at most ``MAX_OVERVIEW_CELLS`` values."""
    step = max(1, math.isqrt(rows * columns // MAX_OVERVIEW_CELLS))
    while -(-rows // step) * -(-columns // step) > MAX_OVERVIEW_CELLS:
        step += 1
    return step


def middles(cells: int, step: int) -> IntArray:
    """Indices of the middle cells of consecutive blocks of `step` cells, the last block cut off at the edge."""
    return np.minimum(np.arange(0, cells, step) + step // 2, cells - 1)


def reduced(layer: NDArray[Any], step: int) -> NDArray[Any]:
    """The values of the layer (rows, columns) at the middle cells of its blocks of step x step cells."""
    return np.asarray(layer[np.ix_(middles(layer.shape[0], step), middles(layer.shape[1], step))])


def checksum(mean_ppb: NDArray[np.float32], std_ppb: NDArray[np.float32]) -> int:
    """CRC-32 of both layers (rows, columns), as in `MapOverview`."""
    crc = zlib.crc32(np.ascontiguousarray(mean_ppb, dtype="<f4").data)
    return zlib.crc32(np.ascontiguousarray(std_ppb, dtype="<f4").data, crc)


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()


def _within_bounds(keep_outs: Iterable[KeepOutArea]) -> tuple[KeepOutArea, ...]:
    shown: list[KeepOutArea] = []
    left = MAX_OVERVIEW_CORNERS
    for area in keep_outs:
        left -= len(area.polygon_m)
        if left < 0:
            break
        shown.append(area)
    return tuple(shown)
