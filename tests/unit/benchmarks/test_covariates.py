"""The benchmark of layers: its fields and their layers, one set of samples, the table, and that it goes on."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import covariates, kept
from benchmarks.covariate_layers import HERODOTUS, survey_of
from benchmarks.covariates import Asked, biased, interval, ratios, table
from he3.errors import InvalidInput
from he3.reference import METRES_PER_DEGREE
from services.console.cli.benchmarks import described
from services.mission.regions import load_window

USEFUL = ("at most", "relation, at most", "relation", "both", "relation, gain 2")
USELESS = ("plain, noise", "relation, gain 0")


@pytest.fixture(scope="module")
def rows():
    return ratios((Asked("t2", None, "random", 20, 3), "matern12"))


@pytest.fixture
def herodotus(tmp_path):
    """Rasters of 20 x 24 pixels under the names of those of Mons Herodotus: FeO is TiO2 and a wave."""
    rasterio = pytest.importorskip("rasterio")
    folder = tmp_path / "leggedrobotics+lunar_planner" / "user_data" / "map_data" / "Herodutus_Mons"
    folder.mkdir(parents=True)
    north, east = np.meshgrid(np.arange(20.0), np.arange(24.0), indexing="ij")
    titanium, waves = 1.0 + east / 8.0, np.sin(north / 3.0)
    files = {
        "clino_feo_tio_plagio.tif": {"lk_cli": waves, "lk_feo": titanium + waves, "wac_tio2_gray": titanium},
        "hsr.tif": {"qts_demstack": north},
    }
    for name, bands in files.items():
        shape = {"height": 20, "width": 24, "count": len(bands), "dtype": "float32"}
        transform = rasterio.Affine(50.0, 0.0, 0.0, 0.0, -50.0, 1000.0)
        with rasterio.open(folder / name, "w", driver="GTiff", transform=transform, **shape) as raster:
            for number, (band, values) in enumerate(bands.items(), 1):
                raster.write(values.astype(np.float32), number)
                raster.set_band_description(number, band)
    return tmp_path


def test_the_benchmark_is_a_command_and_says_what_it_leaves_out_and_refuses():
    assert "covariates" in described()
    with pytest.raises(InvalidInput, match="expected names among t1, t2; got herodotus-feo"):
        covariates.run(fields=(HERODOTUS,))
    with pytest.raises(InvalidInput, match="expected names among lattice, random; got spiral"):
        covariates.run(fields=("t1",), patterns=("spiral",))
    with pytest.raises(InvalidInput, match="expected 2 samples or more, one seed and one pattern at least"):
        covariates.run(samples=(1,))


def test_each_kind_of_layers_has_a_row_and_useful_layers_help_where_useless_ones_change_little(rows):
    found = {row["layers"]: row["ratio"] for row in rows}
    assert len(found) == len(rows) == 16
    assert {row["without_ppb"] for row in rows} == {rows[0]["without_ppb"]}
    assert all(found[name] < 0.95 for name in USEFUL)
    assert all(0.98 < found[name] < 1.02 for name in USELESS)
    assert found["relation, upside down"] > found["relation"] < found["relation, turned"]


def test_the_shifted_layers_show_what_lies_two_pixels_to_the_west():
    survey, window = survey_of("t1", None, 3), load_window("t1")
    pixel_m = METRES_PER_DEGREE / window.pixels_per_degree * np.cos(np.radians(window.origin_lat_deg))
    cells = round(2 * pixel_m / survey.region.grid.resolution_m)
    assert survey.relation_ppb is not None
    assert survey.shifted_relation_ppb is not None
    for there, here in (
        (survey.shifted_layers[0], survey.layers[0]), (survey.shifted_layers[1], survey.layers[1]),
        (survey.shifted_relation_ppb, survey.relation_ppb),
    ):  # fmt: skip
        assert np.abs(there[:, cells:] - here[:, :-cells]).max() < 0.02 * here.std()
    assert np.array_equal(survey.relation_ppb, survey.region.orbital_ppb)


def test_the_variations_of_a_field_have_the_same_layers_and_other_helium():
    one, two = survey_of("t2", None, 1), survey_of("t2", None, 2)
    assert np.array_equal(one.layers, two.layers)
    assert not np.array_equal(one.region.he3_ppb, two.region.he3_ppb)


def test_the_layers_of_mons_herodotus_lie_row_0_south_on_the_cells_of_the_field(herodotus):
    survey = survey_of(HERODOTUS, herodotus, 1)
    titanium, waves, north = survey.layers
    assert north[0, 0] == 19.0  # the raster's last row is the site's first
    field = titanium + waves
    assert np.corrcoef(field.ravel(), survey.region.he3_ppb.ravel())[0, 1] > 0.999
    assert np.array_equal(survey.shifted_layers[:, :, 2:], survey.layers[:, :, :-2])
    rows = ratios((Asked(HERODOTUS, herodotus, "lattice", 20, 1), "matern52"))
    assert {row["layers"].split(",")[0] for row in rows} == {"at most", "plain"}
    assert rows[0]["ratio"] < 0.2  # three layers that tell all of the field


def test_a_biased_layer_is_steeper_and_tilted():
    layer = np.random.default_rng(1).normal(size=(40, 50))
    wrong = biased(layer) - covariates.BIAS * layer
    assert wrong[:, -1] - wrong[:, 0] == pytest.approx(layer.std())


def test_what_a_file_has_is_printed_and_not_computed_again(rows, tmp_path):
    file, said = tmp_path / "rows.json", []
    rows = [row | {"ratio": 9.0} for row in rows]  # which no computation gives
    kept.write(file, {"rows": [*rows, rows[0] | {"seed": 4}]})  # the other seed is not asked for
    found = covariates.run(
        None, ("t2",), (20,), ("random",), seeds=1, first=3, kernel="matern12", json=file, say=said.append
    )
    assert found == rows
    assert said[0] == "herodotus-feo is left out: it takes --data DIR with its rasters"
    assert said[1:] == table(rows)
    assert any(line.startswith("relation, upside down") for line in said)


def test_the_table_has_an_interval_where_there_are_seeds_and_none_for_one_seed(rows):
    alone, both = table(rows), table([*rows, *(row | {"seed": 4, "ratio": row["ratio"] + 0.1} for row in rows)])
    assert not any("(" in line for line in alone[:-1])
    assert sum("(" in line for line in both[:-1]) == len(rows)


def test_the_interval_of_a_mean_holds_it_and_widens_with_the_spread():
    low, high = interval([0.8, 0.9, 1.0, 0.9])
    assert 0.8 < low < 0.9 < high < 1.0
    wide = interval([0.5, 0.9, 1.3, 0.9])
    assert wide[1] - wide[0] > high - low
    assert interval([0.9]) == (0.9, 0.9)
