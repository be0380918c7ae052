"""Times of the map: one more sample, a refit, the whole posterior; compared with scikit-learn and the memory's speed.

Every figure is of the same machine, the same run, the same samples and hyperparameters:

    update_s            one sample taken into mean and variance of every cell, without a refit (median)
    stream_s            what the memory allows: as many float32 values read as the update reads of the rows it keeps,
                        the new row and the two float64 sums written, and the Cholesky factor read once, as fast as
                        plain array operations allow (median)
    read_fraction       the part that the update reads (median) of what it keeps, n float32 values a cell; the rest can
                        change nothing. The squared exponential, being separable, keeps and reads none, and may take
                        less than its stream_s, which is that of reading all n
    refit_s             new hyperparameters from the last ones (warm start), and the whole map recomputed
    update_map_s        update_s, and mean and standard deviation of every cell as a map (median)
    mixture_update_s    the same with the uncertainty of the hyperparameters counted, as in a mission (median)
    mixture_refit_s     new hyperparameters with their uncertainty, and the whole map recomputed
    predict_s           the whole map recomputed, mean and standard deviation of every cell
    sklearn_predict_s   the same from scikit-learn, already fitted, in its fastest chunking, on as many threads

A row for each number of samples and kernel. ``run`` prints them as they come and writes them as JSON.
"""

from __future__ import annotations

from services.runtime.entry import prepare_process

if __name__ == "__main__":
    prepare_process()

import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import kept
from he3.errors import InvalidInput
from he3.frames import FloatArray, SiteGrid
from he3.gp import Hyperparameters, fit_hyperparameters
from he3.hyperprior import Hyperprior
from he3.kernels import AUTO, KERNELS, Kernel, Matern12, SmoothPlusRough, SquaredExponential
from he3.mixture_posterior import MixturePosterior
from he3.posterior.grid import GridPosterior
from services.ground.fitting import FitRequest, fit

SITE = SiteGrid(500, 500, 1.0)
NOISE_STD_PPB = 0.1
CHUNKS = (500, 2000, 10_000)  # cells a call to scikit-learn, the fastest on a trial slice is taken
TRIAL_CELLS = 10_000

Row = dict[str, Any]


def run(
    sizes: Sequence[int] = (150, 1000),
    kernels: Sequence[str] = (*KERNELS, AUTO),
    json: Path | str | None = None,
    *,
    grid: SiteGrid = SITE,
    seed: int = 0,
    threads: int = 2,
    sklearn: bool = True,
    say: Callable[[str], None] = print,
) -> list[Row]:
    """One row for each number of samples and kernel, all times in seconds; printed, and written to ``json`` if given.

    Raises InvalidInput for a size below one, or if scikit-learn is asked for and not installed.
    """
    if any(n < 1 for n in sizes):
        raise InvalidInput(f"expected sizes of one sample or more, got {', '.join(map(str, sizes))}")
    if sklearn:
        _require_sklearn()
    say(
        f"{'n':>5} {'kernel':<13} {'cells':>7} {'update':>9} {'stream':>9} {'ratio':>6} {'read':>5} {'refit':>9} "
        f"{'with map':>9} {'mixture':>9} {'ratio':>6} {'refit':>9} "
        f"{'predict':>9} {'sklearn':>9} {'update vs sklearn':>18}"
    )
    rows = []
    for n in sizes:
        for name in kernels:
            row = measure(n, name, grid=grid, seed=seed, threads=threads, sklearn=sklearn)
            rows.append(row)
            theirs = row["sklearn_predict_s"]
            say(
                f"{n:>5} {name:<13} {row['cells']:>7} {_ms(row['update_s'])} {_ms(row['stream_s'])} "
                f"{row['update_s'] / row['stream_s']:>6.2f} {row['read_fraction']:>5.0%} {_ms(row['refit_s'])} "
                f"{_ms(row['update_map_s'])} {_ms(row['mixture_update_s'])} "
                f"{row['mixture_update_s'] / row['update_map_s']:>6.2f} {_ms(row['mixture_refit_s'])} "
                f"{_ms(row['predict_s'])} "
                + (f"{_ms(theirs)} {theirs / row['update_s']:>17.0f}x" if theirs else f"{'-':>9} {'-':>18}")
            )
    if json is not None:
        document = {"rows": rows, "machine": machine(), "seed": seed, "threads": threads}
        kept.write_whole(json, document)
    return rows


def measure(n: int, kernel_name: str, *, grid: SiteGrid, seed: int, threads: int, sklearn: bool) -> Row:
    """The figures for n samples of a field with a trend and a perturbation."""
    cells = grid.rows * grid.columns
    rng = np.random.default_rng(np.random.SeedSequence([seed, n]))
    places, values = _samples(n + 16, grid, rng)
    extra = list(zip(places[n:], values[n:], strict=True))
    extra_of_mixture = list(extra)
    places, values = places[:n], values[:n]
    before = max(n - 5, 1)
    previous = fit_hyperparameters(places[:before], values[:before], kernel_name, rng=rng, noise_std_ppb=NOISE_STD_PPB)

    start = time.perf_counter()
    fitted = fit_hyperparameters(places, values, kernel_name, rng=rng, noise_std_ppb=NOISE_STD_PPB, previous=previous)
    fit_s = time.perf_counter() - start

    start = time.perf_counter()
    posterior = GridPosterior.build(grid, fitted, places, values, threads=threads)
    posterior.snapshot()
    predict_s = time.perf_counter() - start

    read: list[float] = []

    def update() -> None:
        known = len(posterior)
        posterior.add(*extra.pop())
        read.append(posterior.values_read / (known * cells))

    def update_with_map() -> None:
        posterior.add(*extra.pop())
        posterior.snapshot()

    update_s = _median(update, 8)
    read_fraction = statistics.median(read)
    update_map_s = _median(update_with_map, 8)
    start = time.perf_counter()
    extent_m = max(grid.width_m, grid.height_m)
    inferred = fit(
        FitRequest(
            places, values, kernel_name, NOISE_STD_PPB, fitted, None, (seed, n), extent_m, prior=Hyperprior(extent_m)
        )
    )
    mixture = MixturePosterior(
        grid, inferred, lambda on, of: GridPosterior.build(on, of, places, values, threads=threads)
    )
    mixture.snapshot()
    mixture_refit_s = time.perf_counter() - start

    def update_mixture() -> None:
        mixture.add(*extra_of_mixture.pop())
        mixture.snapshot()

    mixture_update_s = _median(update_mixture, 11)
    streamed = read_fraction or 1.0
    stream_s = _median(stream_of(n, cells, streamed), 11)
    row: Row = {
        "n": n,
        "kernel": kernel_name,
        "cells": cells,
        "update_s": update_s,
        "update_map_s": update_map_s,
        "stream_s": stream_s,
        "read_fraction": read_fraction,
        "refit_s": fit_s + predict_s,
        "mixture_update_s": mixture_update_s,
        "mixture_refit_s": mixture_refit_s,
        "predict_s": predict_s,
        "sklearn_predict_s": None,
        "fit_s": fit_s,
        "bytes": _touched(n, cells, streamed),
    }
    if sklearn:
        row["sklearn_predict_s"], row["sklearn_chunk"] = _sklearn_predict(grid, fitted, places, values, threads)
    return row


def stream_of(n: int, cells: int, fraction: float) -> Callable[[], None]:
    """One pass over arrays as large as those an update touches, reading that fraction of n values a cell."""
    values = round(fraction * n * cells)
    blocks = [np.ones(min(64 * cells, values - first), dtype=np.float32) for first in range(0, values, 64 * cells)]
    row = np.ones(cells, dtype=np.float32)
    sums = [np.ones(cells), np.ones(cells)]
    factor = np.ones(n * n // 2)  # its lower half

    def stream() -> None:
        for block in blocks:
            np.dot(block, block)
        row.fill(1.0)
        for total in sums:
            total += 1.0
        np.dot(factor, factor)

    return stream


def _touched(n: int, cells: int, fraction: float) -> int:
    return round(4 * fraction * n * cells) + cells * (4 + 2 * 2 * 8) + 8 * (n * n // 2)


def machine() -> dict[str, Any]:
    """The machine on which the figures were measured."""
    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "blas_threads": os.environ.get("OPENBLAS_NUM_THREADS", "default"),
    }


def _samples(n: int, grid: SiteGrid, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Places (n, 2) [m] all over the site and noisy values (n,) [ppb] of a drawn field."""
    places = rng.uniform(0.0, 1.0, (n, 2)) * [grid.width_m, grid.height_m]
    field = SmoothPlusRough(1.5, 120.0, 0.5, 25.0)
    factor = np.linalg.cholesky(field.covariance(places, places) + 1e-9 * np.eye(n))
    return places, 8.0 + factor @ rng.normal(size=n) + NOISE_STD_PPB * rng.normal(size=n)


def _sklearn_predict(
    grid: SiteGrid, fitted: Hyperparameters, places: FloatArray, values: FloatArray, threads: int
) -> tuple[float, int]:
    """Seconds that scikit-learn takes for mean and deviation on all cells, and the fastest chunk size [cells]."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from threadpoolctl import threadpool_limits

    model = GaussianProcessRegressor(_sklearn_kernel(fitted.kernel), alpha=fitted.noise_variance, optimizer=None)
    model.fit(places, fitted.standardise(places, values))
    points = grid.points()
    with threadpool_limits(threads):
        chunk = min(CHUNKS, key=lambda size: _seconds(lambda: _in_chunks(model, points[:TRIAL_CELLS], size)))
        return _seconds(lambda: _in_chunks(model, points, chunk)), chunk


def _in_chunks(model: Any, points: FloatArray, chunk: int) -> None:
    for first in range(0, len(points), chunk):
        model.predict(points[first : first + chunk], return_std=True)


def _sklearn_kernel(kernel: Kernel) -> Any:
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

    if isinstance(kernel, SmoothPlusRough):
        return _sklearn_kernel(kernel.smooth) + _sklearn_kernel(kernel.rough)
    variance, length = kernel.parameters().values()
    if isinstance(kernel, SquaredExponential):
        return ConstantKernel(variance) * RBF(length)
    nu = 0.5 if isinstance(kernel, Matern12) else {"matern32": 1.5, "matern52": 2.5}[kernel.name]
    return ConstantKernel(variance) * Matern(length, nu=nu)


def _require_sklearn() -> None:
    try:
        import sklearn
        import threadpoolctl
    except ImportError as missing:
        raise InvalidInput(
            f"the benchmark compares with scikit-learn, and {missing.name} is not installed: "
            'run scripts/setup, or pip install "he3-seeker[bench]"'
        ) from None
    del sklearn, threadpoolctl


def _seconds(work: Callable[[], None]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _median(work: Callable[[], None], times: int) -> float:
    return statistics.median(_seconds(work) for _ in range(times))


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:>7.1f}ms"


if __name__ == "__main__":
    run()
