"""A sample's row on the grid is exact, from every source, also with rows left out by screening."""

from collections.abc import Callable, Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_triangular

from he3.frames import FloatArray, SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import Kernel, Matern12, Matern32, Matern52, SmoothPlusRough, SquaredExponential
from he3.posterior.rows import SPLIT_FROM, RowSource, row_source
from he3.posterior.separable_rows import ChebyshevPiece, SeparableRows
from he3.posterior.split_rows import SplitRows
from he3.posterior.stored_rows import StoredRows, screening_tolerance
from he3.posterior.tiles import Task, TiledGrid

SITE = TiledGrid(SiteGrid(50, 64, 5.0), 13)
NOISE = 0.1
SAMPLES = 160
KERNELS = [
    SquaredExponential(1.2, 25.0),
    Matern12(0.8, 30.0),
    Matern32(1.0, 15.0),
    Matern52(1.1, 15.0),
    SmoothPlusRough(0.8, 90.0, 0.3, 12.0),
]
FLOAT32 = np.dtype(np.float32)
every_precision = pytest.mark.parametrize("dtype", [FLOAT32, np.dtype(np.float64)], ids=lambda dtype: dtype.name)
every_kernel = pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)


def anywhere(rng: np.random.Generator) -> FloatArray:
    return rng.uniform(0, 1, (SAMPLES, 2)) * [SITE.grid.width_m, SITE.grid.height_m]


def along_a_tour(rng: np.random.Generator) -> FloatArray:
    along = np.linspace(0, 10, SAMPLES)
    there_and_back = np.abs(along % 2 - 1)
    return np.column_stack((there_and_back * SITE.grid.width_m, along / 10 * SITE.grid.height_m))


def in_clusters(rng: np.random.Generator) -> FloatArray:
    centres = anywhere(rng)[:5]
    return centres[rng.integers(0, 5, SAMPLES)] + rng.normal(0, 4.0, (SAMPLES, 2))


every_order = pytest.mark.parametrize("order", [anywhere, along_a_tour, in_clusters], ids=lambda order: order.__name__)


def one_by_one(works: Iterable[Task]) -> None:
    for work in works:
        work()


def exact_row(process: GaussianProcess, tiled: TiledGrid) -> FloatArray:
    """The last row of V, in float64, all of it solved for."""
    covariance = process.hyperparameters.covariance(process.places_m, tiled.in_tile_order(tiled.grid.points()))
    row: FloatArray = solve_triangular(process.factor, covariance, lower=True)[-1]
    return row


def process_at(kernel: Kernel, places: FloatArray) -> GaussianProcess:
    return GaussianProcess(Hyperparameters(kernel, NOISE)).condition_on_places(places)


def sources(kernel: Kernel, dtype: np.dtype, screening: float | None = None) -> list[RowSource]:
    found: list[RowSource] = [StoredRows(SITE, kernel, dtype, screening=screening)]
    if isinstance(kernel, SquaredExponential):
        found.append(SeparableRows(SITE, kernel, dtype))
    if isinstance(kernel, SmoothPlusRough):
        smooth = SeparableRows(SITE, kernel.smooth, dtype)
        rough = StoredRows(SITE, kernel.rough, dtype, screening=screening)
        found.append(SplitRows(kernel, smooth, rough, GaussianProcess(Hyperparameters(kernel.rough, NOISE))))
    return found


def recompute(source: RowSource, process: GaussianProcess, tiled: TiledGrid = SITE, part_cells: int = 10**6) -> None:
    rows_on = source.recompute(process)
    for tile in tiled.tiles:
        for part in tile.parts(part_cells):
            for _ in rows_on(part):
                pass


@every_kernel
@every_order
@every_precision
def test_a_row_is_exact_to_what_its_precision_rounds_off(
    kernel: Kernel, order: Callable[[np.random.Generator], FloatArray], dtype: np.dtype
) -> None:
    places = order(np.random.default_rng(11))
    grown, built = sources(kernel, dtype), sources(kernel, dtype)
    process = GaussianProcess(Hyperparameters(kernel, NOISE))
    for place in places[:-1]:
        process = process.condition_on_places(place[None, :])
        for source in grown:
            source.next_row(process, one_by_one)
    for source in built:
        recompute(source, process, part_cells=50)
    process = process.condition_on_places(places[-1:])
    exact = exact_row(process, SITE)
    # A few roundings in the rows before are magnified up to 1 / NOISE times; screening adds less.
    allowed = 4 * float(np.finfo(dtype).eps) / NOISE + screening_tolerance(dtype)
    # What it is compared with is rounded in float64 itself, and so is the interpolation of the separable rows.
    allowed = max(allowed, 1e-13 / NOISE)
    for source in (*grown, *built):
        error = np.abs(source.next_row(process, one_by_one) - exact).max()
        assert error <= allowed * np.sqrt(kernel.prior_variance)


@every_kernel
@every_precision
def test_what_a_row_leaves_out_changes_it_by_less_than_the_tolerance(kernel: Kernel, dtype: np.dtype) -> None:
    places = anywhere(np.random.default_rng(12))
    rounding = max(2 * float(np.finfo(dtype).eps), 1e-14)
    for screened, whole in zip(sources(kernel, dtype), sources(kernel, dtype, screening=1e-30), strict=True):
        process = process_at(kernel, places[:-1])
        for source in (screened, whole):
            recompute(source, process)
        process = process.condition_on_places(places[-1:])
        difference = screened.next_row(process, one_by_one) - whole.next_row(process, one_by_one)
        assert np.abs(difference).max() <= (screening_tolerance(dtype) + rounding) * np.sqrt(kernel.prior_variance)
        assert screened.values_read <= whole.values_read


@pytest.mark.parametrize(
    ("kernel", "most"),
    [(Matern12(1.0, 40.0), 0.5), (Matern52(1.0, 8.0), 0.2), (SmoothPlusRough(0.8, 90.0, 0.3, 8.0), 0.4)],
    ids=lambda value: getattr(value, "name", ""),
)
def test_on_a_wide_site_most_rows_are_not_read(kernel: Kernel, most: float) -> None:
    wide = TiledGrid(SiteGrid(80, 80, 5.0), 16)
    places = np.random.default_rng(13).uniform(0, 400, (SPLIT_FROM + 1, 2))
    source = row_source(wide, Hyperparameters(kernel, NOISE), FLOAT32, SPLIT_FROM)
    process = process_at(kernel, places[:-1])
    recompute(source, process, wide)
    process = process.condition_on_places(places[-1:])
    row = source.next_row(process, one_by_one)
    assert 0 < source.values_read < most * SPLIT_FROM * wide.cells
    assert np.abs(row - exact_row(process, wide)).max() <= 8 * screening_tolerance(FLOAT32) * np.sqrt(
        kernel.prior_variance
    )


def test_each_kernel_has_its_fastest_source() -> None:
    def source(kernel: Kernel, bulk_count: int | None = None) -> type[RowSource]:
        return type(row_source(SITE, Hyperparameters(kernel), FLOAT32, bulk_count))

    smooth_plus_rough = SmoothPlusRough()
    assert source(SquaredExponential()) is SeparableRows
    assert source(Matern32()) is StoredRows
    assert source(smooth_plus_rough) is SplitRows
    assert source(smooth_plus_rough, SPLIT_FROM) is SplitRows
    assert source(smooth_plus_rough, SPLIT_FROM - 1) is StoredRows


@settings(max_examples=200)
@given(st.floats(1.0, 2000.0), st.integers(1, 200), st.floats(-800.0, 800.0))
def test_a_squared_exponential_is_known_from_its_nodes_wherever_it_is_centred(
    length: float, cells: int, centre: float
) -> None:
    cells_m = 3.0 + np.arange(cells)
    piece = ChebyshevPiece.of(cells_m, length)
    assert len(piece.nodes_m) <= cells

    def at(x_m: FloatArray) -> FloatArray:
        values: FloatArray = np.exp(-0.5 * ((x_m - centre) / length) ** 2)
        return values

    np.testing.assert_allclose(piece.to_cells @ at(piece.nodes_m), at(cells_m), atol=1e-14)


def test_a_long_length_scale_takes_few_nodes() -> None:
    assert len(ChebyshevPiece.of(np.arange(125.0), 60.0).nodes_m) < 30
