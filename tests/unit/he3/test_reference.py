"""The five steps from orbital rasters to a finished region, on windows whose answer is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from he3.errors import InvalidInput
from he3.frames import SiteGrid
from he3.reference import METRES_PER_DEGREE, OrbitalWindow, Region, orbital_view, reference, resample
from he3.regolith import RegolithModel

PIXELS, PER_DEGREE, LATITUDE = 24, 512.0, 26.0
PIXEL_NORTH_M = METRES_PER_DEGREE / PER_DEGREE
GRID = SiteGrid(500, 500, 1.0)


def window(**layers: np.ndarray) -> OrbitalWindow:
    """A window around a region whose south-west corner is 7.3 and 8.6 pixels into it."""
    south, west = LATITUDE, 3.0
    flat = {"iron_wt": 16.0, "maturity": 0.2, "elevation_m": -1900.0}
    filled = {name: layers.get(name, np.full((PIXELS, PIXELS), value)) for name, value in flat.items()}
    return OrbitalWindow(
        name="test",
        title="Test",
        provenance="made for a test",
        south_deg=south,
        west_deg=west,
        pixels_per_degree=PER_DEGREE,
        origin_lat_deg=south + 7.3 / PER_DEGREE,
        origin_lon_deg=west + 8.6 / PER_DEGREE,
        solar_wind_flux=0.5,
        seed=5,
        **filled,
    )


def pixel_centres_m() -> tuple[np.ndarray, np.ndarray]:
    """North and east of the pixel centres in the site frame, computed by hand."""
    middle = math.radians(LATITUDE + 7.3 / PER_DEGREE + 250 / METRES_PER_DEGREE)
    steps = np.arange(PIXELS) + 0.5
    return (steps - 7.3) * PIXEL_NORTH_M, (steps - 8.6) * PIXEL_NORTH_M * math.cos(middle)


def textured(seed: int = 0) -> OrbitalWindow:
    random = np.random.default_rng(seed)
    iron = 16 * (1 + 0.03 * random.standard_normal((PIXELS, PIXELS)))
    omat = 0.2 * (1 + 0.05 * random.standard_normal((PIXELS, PIXELS)) - 0.5 * (iron / 16 - 1))
    return window(iron_wt=iron, maturity=omat, elevation_m=-1900 + 3 * random.standard_normal((PIXELS, PIXELS)))


def test_resampling_puts_a_cubic_surface_exactly_where_it_belongs_on_the_ground() -> None:
    """Bicubic splines reproduce cubics; a shift, a flip or a pixel square in metres would not."""
    north, east = (v / 500 for v in pixel_centres_m())

    def surface(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.asarray(2 * y**3 - y * x**2 + 0.5 * x**3 + y - 3 * x)

    fine = resample(window(), surface(north[:, None], east[None, :]), GRID)
    assert fine == pytest.approx(surface(GRID.y_m[:, None] / 500, GRID.x_m[None, :] / 500), abs=1e-9)


def test_a_margin_continues_the_same_surface() -> None:
    north, east = pixel_centres_m()
    layer = np.sin(north / 120)[:, None] + np.cos(east / 150)[None, :]
    assert resample(window(), layer, GRID, 50)[50:-50, 50:-50] == pytest.approx(resample(window(), layer, GRID))


@pytest.mark.parametrize(("south_pixels", "west_pixels"), [(1.0, 8.0), (8.0, 1.0), (15.5, 8.0), (8.0, 14.5)])
def test_a_window_that_does_not_surround_the_region_is_refused(south_pixels: float, west_pixels: float) -> None:
    shifted = replace(
        window(), origin_lat_deg=LATITUDE + south_pixels / PER_DEGREE, origin_lon_deg=3.0 + west_pixels / PER_DEGREE
    )
    with pytest.raises(InvalidInput, match=r"test: expected a raster window that surrounds"):
        reference(shifted)


def test_without_perturbation_a_flat_window_gives_the_helium_of_the_formula_everywhere() -> None:
    region = reference(window(), perturbation=0.0)
    by_hand = 0.56 * 10 ** (0.06 * 16 - 0.54) * 0.5 / 0.2 + 1.62
    assert region.he3_ppb.shape == region.orbital_ppb.shape == (500, 500)
    np.testing.assert_allclose(region.he3_ppb, by_hand, rtol=1e-6)
    np.testing.assert_allclose(region.orbital_ppb, by_hand, rtol=1e-6)
    assert region.traversable.all()


def test_iron_and_omat_vary_by_five_percent_and_helium_follows_by_propagation() -> None:
    """Over seeds, the spread of log(He-3 - 1.62) is that of 0.06 ln(10) FeO g1 - g2, five percent each."""
    spreads = []
    for seed in range(8):
        he3 = reference(window(), seed).he3_ppb
        spreads.append(np.log(he3 - 1.62).var())
    wanted = 0.05**2 * ((0.06 * math.log(10) * 16) ** 2 + 1)
    assert np.mean(spreads) == pytest.approx(wanted, rel=0.06)


def test_variations_of_iron_and_omat_share_the_correlation_of_the_layers() -> None:
    """Anticorrelated layers widen the spread of helium, correlated ones narrow it, as propagation says."""
    random = np.random.default_rng(1)
    common = random.standard_normal((PIXELS, PIXELS))
    gain = 0.06 * math.log(10) * 16
    for sign in (-1.0, 1.0):
        other = sign * 0.8 * common + 0.6 * random.standard_normal((PIXELS, PIXELS))
        rho = np.corrcoef(common.ravel(), other.ravel())[0, 1]
        layers = window(iron_wt=16 * (1 + 1e-6 * common), maturity=0.2 * (1 + 1e-6 * other))
        spread = np.mean([np.log(reference(layers, seed).he3_ppb - 1.62).var() for seed in range(8)])
        assert spread == pytest.approx(0.05**2 * (gain**2 + 1 - 2 * rho * gain), rel=0.08)


def test_the_variation_is_rough_with_the_papers_length() -> None:
    logs = [np.log(reference(window(), seed).he3_ppb - 1.62) for seed in range(8)]
    scale = np.mean([log.var() for log in logs])
    along = np.mean([((log - log.mean())[:, 25:] * (log - log.mean())[:, :-25]).mean() for log in logs])
    assert along / scale == pytest.approx(math.exp(-1), abs=0.06)


def test_titanium_and_helium_are_recomputed_and_elevation_is_not_perturbed() -> None:
    """Helium never falls below the offset, and terrain is the same for every seed."""
    first, second = reference(textured(), 1), reference(textured(), 2)
    assert not np.array_equal(first.he3_ppb, second.he3_ppb)
    assert np.array_equal(first.elevation_m, second.elevation_m)
    assert np.array_equal(first.traversable, second.traversable)
    assert np.array_equal(first.orbital_ppb, second.orbital_ppb)
    assert min(first.he3_ppb.min(), second.he3_ppb.min()) > 1.62


def test_a_seed_makes_the_same_region_again_and_the_windows_own_is_the_default() -> None:
    assert np.array_equal(reference(textured()).he3_ppb, reference(textured(), 5).he3_ppb)
    assert reference(textured()).seed == 5


def test_the_orbital_map_is_the_coarse_helium_at_the_pixel_centres() -> None:
    coarse = textured()
    north, east = pixel_centres_m()
    model = RegolithModel()
    by_hand = model.helium3_ppb(model.titanium_wt(coarse.iron_wt), coarse.maturity, 0.5)
    region = reference(coarse)
    for row, column in ((9, 11), (12, 14), (14, 12)):
        rows, columns = GRID.cells_of(np.array([[east[column], north[row]]]))
        assert region.orbital_ppb[rows[0], columns[0]] == pytest.approx(by_hand[row, column], abs=0.03)


def test_relief_at_the_regions_edge_knows_the_ground_beyond_it() -> None:
    """A pit just outside the western edge counts in the relief at the edge."""
    north, east = pixel_centres_m()
    pit = -1900 - 12 * np.exp(-((north[:, None] - 250) ** 2 + (east[None, :] + 75) ** 2) / (2 * 50**2))
    with_pit = reference(window(elevation_m=pit))
    assert with_pit.slope_deg[250, 0] > 3.0
    assert with_pit.slope_deg.shape == (500, 500)


def test_other_grids_and_coefficients_can_be_asked_for() -> None:
    small = reference(textured(), grid=SiteGrid(60, 80, 5.0), model=RegolithModel(titanium_slope=0.0816))
    assert small.he3_ppb.shape == (60, 80)
    assert small.he3_ppb.mean() > reference(textured()).he3_ppb.mean()


def test_a_finished_region_cannot_be_changed() -> None:
    region = reference(textured())
    for layer in (region.he3_ppb, region.orbital_ppb, region.elevation_m, region.slope_deg, region.traversable):
        with pytest.raises(ValueError, match="read-only"):
            layer[0, 0] = 0
    with pytest.raises(AttributeError):
        region.name = "other"  # type: ignore[misc]


def test_a_region_whose_maps_do_not_fit_its_grid_is_refused() -> None:
    flat = np.zeros((5, 5))
    with pytest.raises(InvalidInput, match="odd: expected elevation_m"):
        Region(
            name="odd",
            title="",
            provenance="",
            grid=SiteGrid(5, 5),
            he3_ppb=flat,
            orbital_ppb=flat.copy(),
            elevation_m=np.zeros((5, 4)),
            slope_deg=flat.copy(),
            traversable=flat > -1,
        )


@pytest.mark.parametrize(
    ("layer", "value", "said"),
    [
        ("iron_wt", math.nan, "iron_wt: expected finite values, got NaN or infinity in 1 cell, at row 3, column 4"),
        ("iron_wt", -1.0, "wt %, got -1 in 1 cell, at row 3, column 4"),
        ("iron_wt", 65535.0, "got 65535 in 1 cell"),
        ("maturity", 0.0, "got 0 in 1 cell, at row 3, column 4"),
        ("maturity", 1e20, r"got 1e\+20 in 1 cell"),
        ("elevation_m", -3.4028226550889045e38, "expected -9500 to 11000 m, got -3.40282e"),
        ("elevation_m", -9999.0, "got -9999 in 1 cell"),
        ("elevation_m", -2999.0, "expected steps of at most 676.9"),
    ],
)
def test_rasters_with_missing_values_are_refused_with_their_place(layer: str, value: float, said: str) -> None:
    raster = np.full((PIXELS, PIXELS), 0.2)
    raster[3, 4] = value
    with pytest.raises(InvalidInput, match=said):
        window(**{layer: raster})


def test_rasters_of_different_shapes_are_refused() -> None:
    with pytest.raises(InvalidInput, match="expected maturity"):
        window(maturity=np.full((PIXELS, PIXELS + 1), 0.2))


def test_an_orbiter_sees_the_mean_and_the_broad_shape_but_not_the_detail() -> None:
    trend = 5 + 2 * np.sin(GRID.y_m / 130)[:, None] + np.cos(GRID.x_m / 110)[None, :]
    detail = np.where(np.indices((500, 500)).sum(axis=0) % 2 == 0, 1.0, -1.0)
    view = orbital_view(trend + detail, GRID)
    assert view.mean() == pytest.approx(trend.mean(), abs=0.02)
    assert np.abs(view - trend)[30:-30, 30:-30].max() < 0.15


@pytest.mark.parametrize("resolution_m", [16.0, 50.0, 59.3, 100.0, 1000.0])
def test_of_cells_as_large_as_a_footprint_an_orbiter_sees_means_of_several(resolution_m: float) -> None:
    """White noise: a mean over 4 x 4 cells keeps a quarter of its deviation, and tells little of any one cell."""
    field = np.random.default_rng(0).uniform(3, 9, (120, 90))
    view = orbital_view(field, SiteGrid(120, 90, resolution_m))
    assert view.mean() == pytest.approx(field.mean(), abs=0.02)
    assert view.std() < 0.3 * field.std()
    assert np.corrcoef(view.ravel(), field.ravel())[0, 1] < 0.4


def test_an_orbiter_over_a_region_of_one_footprint_sees_its_mean() -> None:
    field = np.random.default_rng(0).uniform(3, 9, (40, 40))
    assert orbital_view(field, SiteGrid(40, 40)) == pytest.approx(np.full((40, 40), field.mean()))
