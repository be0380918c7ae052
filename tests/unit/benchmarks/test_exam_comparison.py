"""The exam at equal metres: `tour` within the metres of SGP-Tools, and `tour` beside the better of two others."""

import numpy as np
import pytest

from benchmarks.exam import Task, surveys
from benchmarks.exam_comparison import comparison, comparisons
from benchmarks.exam_methods import METHODS, Settings, with_needed

SETTINGS = Settings(samples=10, kernel="matern52", likeliest=True, start_m=(10.5, 10.5))


@pytest.fixture
def data(tmp_path):
    """A folder with one small field of two waves."""
    x, y = np.meshgrid(np.arange(40.0), np.arange(30.0))
    np.save(tmp_path / "waves.npy", np.sin(x / 5.0) + 0.7 * np.cos(y / 4.0))
    return tmp_path


def flown(data, methods, known=()):
    """The rows that are added to the known ones, by method."""
    rows = list(surveys(Task("waves.npy", data, None, SETTINGS, 1, tuple(methods), tuple(known))))
    assert not any("failed" in row for row in rows), rows
    return {row["method"]: row for row in rows}


def driven(method, metres):
    """A row from before, of which only the metres are read."""
    return {"method": method, "metres": metres}


def test_a_method_comes_behind_the_one_that_it_needs():
    names = list(METHODS)
    needed = [(name, method.after) for name, method in METHODS.items() if method.after is not None]
    assert all(names.index(after) < names.index(name) for name, after in needed)
    assert ("tour-matched", "sgptools") in needed
    assert with_needed(["tour-matched+sklearn"]) == ("tour", "sgptools", "tour-matched", "tour-matched+sklearn")
    assert with_needed(["random", "tour"]) == ("tour", "random")


def test_the_matched_tour_takes_all_its_samples_within_the_metres_of_the_peer(data):
    tour = flown(data, ["tour"])["tour"]
    for share in (0.99, 0.9, 0.6):
        peer = driven("sgptools", share * tour["metres"])
        matched = flown(data, ["tour-matched"], [tour, peer])
        assert list(matched) == ["tour-matched"]
        assert 0.9 * peer["metres"] < matched["tour-matched"]["metres"] <= peer["metres"]
        assert matched["tour-matched"]["samples"] == 10


def test_a_budget_of_the_whole_exam_holds_for_the_matched_tour_too(data):
    known = [driven("tour", 70.0), driven("sgptools", 70.0)]
    settings = Settings(**{name: getattr(SETTINGS, name) for name in Settings.__slots__} | {"budget_m": 50.0})
    task = Task("waves.npy", data, None, settings, 1, ("tour-matched",), tuple(known))
    assert [row["metres"] <= 50.0 for row in surveys(task)] == [True]


def test_a_matched_tour_goes_on_from_its_row_and_scikit_learn_maps_its_very_samples(data):
    known = [driven("tour", 70.0), driven("sgptools", 60.0)]
    matched = flown(data, ["tour-matched"], known)["tour-matched"]
    after = flown(data, ["tour-matched", "tour-matched+sklearn"], [*known, matched])
    assert list(after) == ["tour-matched+sklearn"]
    at_once = flown(data, ["tour-matched", "tour-matched+sklearn"], known)
    assert {name: row["nrmse"] for name, row in at_once.items()} == {
        "tour-matched": matched["nrmse"], "tour-matched+sklearn": after["tour-matched+sklearn"]["nrmse"]}  # fmt: skip
    assert at_once["tour-matched+sklearn"]["metres"] == matched["metres"]


def test_a_method_that_another_one_needs_is_kept_too(data):
    rows = flown(data, ["tour+sklearn"])
    assert list(rows) == ["tour", "tour+sklearn"]
    assert flown(data, ["tour+sklearn"], rows.values()) == {}
    # A needed survey is not flown again, although its row has no map.
    assert list(flown(data, ["tour+sklearn"], [rows["tour"]])) == ["tour+sklearn"]


def test_the_comparison_is_with_the_better_of_both_on_surveys_that_all_three_have():
    names = ("tour", "tour+sklearn", "sgptools")

    def three(field, seed, errors, densities, metres):
        figures = zip(names, errors, densities, metres, strict=True)
        return [{"field": field, "seed": seed, "method": name, "nrmse": error, "nlpd": density, "metres": driven_m,
                 "samples": 150} for name, error, density, driven_m in figures]  # fmt: skip

    rows = [
        *three("a", 1, (0.4, 0.5, 0.6), (1.0, 2.0, 3.0), (98.0, 98.0, 100.0)),
        *three("a", 2, (0.4, 0.5, 0.6), (2.5, 2.0, 3.0), (100.0, 100.0, 100.0)),  # scikit-learn's density is lower
        *three("b", 1, (0.6, 0.7, 0.5), (4.0, 1.0, 5.0), (104.0, 104.0, 100.0)),
        *three("c", 1, (9.0, 9.0, 9.0), (9.0, 9.0, 9.0), (1.0, 1.0, 1.0))[:2],  # without the peer
    ]
    said = comparison(rows, names)
    assert said[0] == "tour / tour+sklearn / sgptools: 3 surveys of 2 fields"
    assert "0.500 / 0.600 / 0.550: 0.909 of the better mean" in said[1]
    assert "1.000 on average, 0.800 to 1.200" in said[1]
    assert "lower than both on 1 of 2 fields" in said[2]
    assert "lower than tour+sklearn in 1, than sgptools in 3" in said[2]
    assert "1.0067 of those of sgptools on average, 0.9800 to 1.0400; more than it in 1 surveys" in said[3]
    assert "samples 150 to 150" in said[3]
    assert comparisons(rows) == said
    assert comparisons([row for row in rows if row["method"] != "sgptools"]) == []
