"""The exam: patterns of places, results that are kept, tables, and surveys of a small field."""

import json
from dataclasses import replace
from math import inf

import numpy as np
import pytest

from benchmarks import exam
from benchmarks.exam_fields import load_field
from benchmarks.exam_methods import METHODS, Asked, Settings, sklearn_map
from benchmarks.exam_patterns import at_random, boustrophedon, hexagonal, moved_onto
from benchmarks.exam_picture import draw
from benchmarks.peer_environments import PYPOLO, SGPTOOLS
from he3.errors import InvalidInput
from he3.frames import SiteGrid, path_length
from services.console.cli.benchmarks import described

GRID = SiteGrid(30, 40, 2.0)
OPEN = np.ones(GRID.shape, dtype=bool)
COVERS = ("boustrophedon", "hexagonal", "random")


@pytest.fixture
def data(tmp_path):
    """A folder with one small field: two waves, and a corner without values."""
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    values = np.sin(x / 9.0) + 0.7 * np.cos(y / 7.0)
    values[:4, 30:] = np.nan
    folder = tmp_path / "data"
    folder.mkdir()
    np.save(folder / "waves.npy", values)
    return folder


@pytest.mark.parametrize("samples", [1, 7, 20, 150])
@pytest.mark.parametrize("pattern", [boustrophedon, hexagonal])
def test_a_cover_has_exactly_its_samples_all_on_the_site(pattern, samples):
    places = pattern(samples, 80.0, 60.0)
    assert places.shape == (samples, 2)
    assert GRID.contains(places).all()


def test_a_cover_leaves_no_place_far_from_a_sample_and_is_driven_without_detours():
    cells = GRID.points()
    for pattern in (boustrophedon, hexagonal):
        places = pattern(48, 80.0, 60.0)
        farthest = np.hypot(*(cells[:, None] - places[None]).transpose(2, 0, 1)).min(axis=1).max()
        assert farthest < 9.0
        assert path_length(places) < 1.15 * 47 * 10.0


def test_the_rows_of_a_hexagonal_cover_are_shifted_and_those_of_a_lawn_mower_are_not():
    def columns(places, row):
        return np.sort(places[np.isclose(places[:, 1], np.unique(places[:, 1])[row])][:, 0])

    lawn, lattice = boustrophedon(48, 80.0, 60.0), hexagonal(42, 84.0, 63.0)
    assert np.allclose(columns(lawn, 0), columns(lawn, 1))
    apart = np.diff(columns(lattice, 0))[0]
    assert abs(columns(lattice, 0)[0] - columns(lattice, 1)[0]) == pytest.approx(apart / 2, rel=0.2)


def test_random_places_lie_on_open_ground_and_follow_the_seed():
    ground = OPEN.copy()
    ground[:, :20] = False
    places = at_random(50, GRID, ground, (70.0, 50.0), 1)
    assert (places[:, 0] >= 40.0).all()
    assert (places == at_random(50, GRID, ground, (70.0, 50.0), 1)).all()
    assert not (places == at_random(50, GRID, ground, (70.0, 50.0), 2)).all()


def test_places_are_moved_to_the_centre_of_their_cell_or_of_the_nearest_open_one():
    ground = OPEN.copy()
    ground[:, :5] = False
    moved = moved_onto(np.array([[1.0, 31.0], [55.5, 20.2]]), GRID, ground)
    assert moved.tolist() == [[11.0, 31.0], [55.0, 21.0]]


def test_the_same_command_goes_on_and_adds_what_is_new(data, tmp_path, monkeypatch):
    monkeypatch.setenv(SGPTOOLS.variable, str(tmp_path / "none"))
    out, said = tmp_path / "exam.json", []
    asked = {"samples": 10, "kernel": "matern52", "hyperparameters": "ml", "json": out, "fields": ("waves.npy",)}
    settings = {"samples": 10, "kernel": "matern52", "likeliest": True, "budget_m": inf, "start_m": None, "noise": None}
    # No method has this error, so a row that is flown again shows.
    row = {"field": "waves.npy", "method": "boustrophedon", "seed": 1, **dict.fromkeys(exam.SCORES, 0.123)}
    exam.Kept(out, settings).add({**row, "metres": 99.0, "samples": 10})
    methods = (*COVERS, "sgptools", "tour-matched")
    rows = exam.run(data, methods=methods, seeds=1, **asked, picture=tmp_path / "p.png", say=said.append)
    assert [row["method"] for row in rows] == list(COVERS)
    assert [row["nrmse"] == 0.123 for row in rows] == [True, False, False]
    assert len(json.loads(out.read_text())["rows"]) == 3
    assert all(0 < row["nrmse"] < 1.5 and row["samples"] == 10 and row["metres"] > 50 for row in rows)
    absent = [line.split()[0] for line in said if "not installed" in line]
    assert absent == ["sgptools", "tour-matched"]
    assert (tmp_path / "p.png").stat().st_size > 10_000
    with pytest.raises(InvalidInput, match="results of the same settings, got kernel matern52; name another file"):
        exam.run(data, methods=("random",), **{**asked, "kernel": "se"})


def test_rows_of_a_raster_that_has_other_values_now_are_not_mixed_with_new_ones(data, tmp_path):
    asked = {"samples": 10, "methods": ("random",), "seeds": 1, "json": tmp_path / "exam.json", "say": str}
    exam.run(data, **asked, fields=("waves.npy",))
    exam.run(data, **asked, fields=("waves.npy",))
    values = np.load(data / "waves.npy")
    np.save(data / "waves.npy", values[::-1])
    with pytest.raises(InvalidInput, match=r"exam\.json: expected results of waves\.npy as it is now, got those"):
        exam.run(data, **asked, fields=("waves.npy",))


def test_an_exam_of_methods_that_are_all_missing_says_how_to_install_them(monkeypatch):
    monkeypatch.setenv("HE3_PEERS_PYTHON", "/nonexistent")
    with pytest.raises(InvalidInput, match="SGP-Tools needs a separate environment, expected its interpreter at /none"):
        exam.run(fields=("t1",), methods=("tour-matched",), seeds=1)


def test_a_budget_holds_for_a_cover_too(data):
    settings = Settings(samples=10, kernel="matern52", likeliest=True, budget_m=40.0, start_m=(20.5, 15.5))
    survey = METHODS["hexagonal"].fly(Asked(load_field("waves.npy", data), settings, seed=1))
    assert survey.metres <= 40.0
    assert 1 < len(survey.places_m) < 10


@pytest.mark.exhaustive
def test_scikit_learn_maps_the_very_samples_of_a_cover(data):
    settings = Settings(samples=10, kernel="matern52", likeliest=True, start_m=(20.5, 15.5))
    asked = Asked(load_field("waves.npy", data), settings, seed=1)
    for pattern in ("hexagonal", "random"):
        own, theirs = METHODS[pattern].fly(asked), METHODS[f"{pattern}+sklearn"].fly(asked)
        assert np.array_equal(own.places_m, theirs.places_m)
        assert np.array_equal(own.values_ppb, theirs.values_ppb)
        assert own.metres == theirs.metres
        assert not np.allclose(own.mean_ppb, theirs.mean_ppb)


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"samples": 12}, "rounds of 5"),
        ({"start": (39.0, 1.0)}, "waves.npy: expected a start on open ground"),
        ({"start": (1.0,)}, "a start X,Y"),
        ({"budget": 0.0}, "positive budget"),
        ({"kernel": "cubic"}, "a kernel among"),
        ({"methods": ("teleport",)}, "methods among"),
        ({"fields": ("moon",)}, "fields out of"),
        ({"seeds": 0}, "one seed"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_flown(wrong, why, data):
    with pytest.raises(InvalidInput, match=why):
        exam.run(data, **{"fields": ("waves.npy",), **wrong})


def test_a_file_that_is_no_exam_is_refused(data, tmp_path):
    (tmp_path / "other.json").write_text('{"rows": []}')
    with pytest.raises(InvalidInput, match="expected results of an exam"):
        exam.run(data, fields=("waves.npy",), json=tmp_path / "other.json")


def test_tables_have_intervals_over_seeds_and_compare_with_tour():
    row = {"field": "a", "method": "tour", "seed": 1, "nrmse": 0.5, "nlpd": 1.0, "crps": 0.2, "coverage_50": 0.5,
           "coverage_68": 0.7, "coverage_95": 0.9, "metres": 1000.0, "samples": 150}  # fmt: skip
    rows = [row, {**row, "seed": 2, "nrmse": 0.6}, {**row, "field": "b"},
            {**row, "method": "random", "nrmse": 0.66, "metres": 2000.0}]  # fmt: skip
    lines = exam.report(rows, ["a", "b"], ["sgptools"])
    tour = next(line for line in lines if line.startswith("tour"))
    assert "0.550 +- 0.635" in tour
    means = lines[next(k for k, line in enumerate(lines) if line.startswith("means")) :]
    assert "1.200" in next(line for line in means if line.startswith("random"))
    assert "2.000" in next(line for line in means if line.startswith("random"))


def test_scikit_learn_s_map_knows_a_smooth_field_from_its_samples_and_says_its_kernel():
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    field = np.sin(x / 15.0) + 0.7 * np.cos(y / 12.0)
    places = boustrophedon(30, 80.0, 60.0)
    mean, std, kernel = sklearn_map(GRID, places, field[GRID.cells_of(places)], 0.01, 1, restarts=0)
    assert np.sqrt(np.mean((mean - field) ** 2)) < 0.2 * field.std()
    assert 0 < std.min() < std.max() < field.std()
    assert "WhiteKernel" in kernel


def test_the_picture_needs_no_second_seed(tmp_path):
    row = {"field": "a", "method": "tour", "nrmse": 0.5, "coverage_50": 0.5, "coverage_68": 0.7, "coverage_95": 0.9}
    assert draw([row], ["a"], tmp_path / "new" / "p.png").is_file()


def test_the_exam_is_a_command_and_its_parts_are_not():
    assert "exam" in described()
    assert not any(name.startswith("exam-") for name in described())


def test_a_peer_that_is_not_there_says_how_it_is_installed(monkeypatch, tmp_path):
    monkeypatch.setenv(PYPOLO.variable, str(tmp_path / "none"))
    assert not PYPOLO.installed
    with pytest.raises(InvalidInput, match=r"pip install -r benchmarks/peers/requirements-pypolo.txt"):
        PYPOLO.python()
    assert not replace(PYPOLO, folder="nowhere", variable="HE3_NO_SUCH_VARIABLE").installed


def test_a_folder_without_rasters_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="which has none"):
        exam.run(data=tmp_path)
