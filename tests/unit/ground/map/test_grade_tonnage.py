"""The grade-tonnage curve: brute force over drawn fields, closed forms, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from he3.errors import InvalidInput, NotReady
from he3.frames import SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.kernels import kernel_from
from he3.resource import grade_tonnage
from schemas.maps import GradeTonnageQuery, ResourceQuery
from services.ground.map.resources import MOST_STEPS, estimate, grade_tonnage_curve
from services.ground.map.snapshot import MapSnapshot

GRID = SiteGrid(24, 30, 5.0)
CORNERS = "10,10,100,10,100,100,10,100"


def snapshot(samples: int = 12, level_ppb: float = 8.0) -> MapSnapshot:
    random = np.random.default_rng(3)
    process = GaussianProcess(Hyperparameters(kernel_from("matern32"), 0.1, level_ppb, 1.5)).condition(
        random.uniform(0.0, (GRID.width_m, GRID.height_m), (samples, 2)), random.normal(level_ppb, 1.0, samples)
    )
    mean, std = (each.reshape(GRID.shape).astype(np.float32) for each in process.predict(GRID.points()))
    return MapSnapshot(
        grid=GRID, mean_ppb=mean, std_ppb=std, traversable=np.ones(GRID.shape, dtype=np.bool_), samples=(),
        driven_path_m=(), planned_path_m=(), plan_ends=None, revision=7, mission_time_ns=123, score=None,
        score_history=(), process=process,
    )  # fmt: skip


def test_of_each_field_the_ground_above_a_cut_off_is_summed_by_its_blocks() -> None:
    random = np.random.default_rng(1)
    fields, weights = random.normal(8.0, 2.0, (5, 40)), random.dirichlet(np.ones(40))
    cutoffs = np.array([-1.0, 7.0, 8.5, 9.0, 99.0])
    shares, grades = grade_tonnage(fields, weights, cutoffs)
    for draw, field in enumerate(fields):
        for number, cutoff in enumerate(cutoffs):
            above = field > cutoff
            assert shares[draw, number] == pytest.approx(weights[above].sum())
            if above.any():
                assert grades[draw, number] == pytest.approx(np.average(field[above], weights=weights[above]))
            else:
                assert np.isnan(grades[draw, number])


def test_a_value_equal_to_the_cut_off_is_not_above_it() -> None:
    shares, grades = grade_tonnage(np.array([[8.0, 9.0]]), np.array([0.25, 0.75]), np.array([8.0, 9.0]))
    assert shares.tolist() == [[0.75, 0.0]]
    assert grades[0, 0] == 9.0
    assert np.isnan(grades[0, 1])


def test_the_curve_of_a_normal_field_is_the_closed_form() -> None:
    fields = np.random.default_rng(1).normal(8.0, 1.0, (1, 200_000))
    cutoffs = np.array([7.0, 8.0, 9.0])
    shares, grades = grade_tonnage(fields, np.full(200_000, 1 / 200_000), cutoffs)
    assert shares[0] == pytest.approx(norm.sf(cutoffs - 8.0), abs=0.005)
    assert grades[0] == pytest.approx(8.0 + norm.pdf(cutoffs - 8.0) / norm.sf(cutoffs - 8.0), abs=0.02)


def test_at_a_cut_off_of_zero_the_curve_has_the_whole_area_and_its_estimate() -> None:
    shown = snapshot()
    found = grade_tonnage_curve(GradeTonnageQuery(polygon=CORNERS, cutoffs="0"), shown)
    whole = estimate(ResourceQuery(polygon=CORNERS), shown)
    (point,) = found.curve
    assert found.area_m2 == whole.area_m2
    assert (point.area_m2.low, point.area_m2.high) == pytest.approx((8100.0, 8100.0))
    assert point.mean_ppb is not None
    assert point.mean_ppb.expected == pytest.approx(whole.mean_ppb.expected, abs=0.02)
    for end in ("low", "high"):
        assert getattr(point.mean_ppb, end) == pytest.approx(getattr(whole.mean_ppb, end), abs=0.06)
        assert getattr(point.mass_kg_per_m, end) == pytest.approx(getattr(whole.mass_kg_per_m, end), rel=0.01)


def test_the_area_above_a_cut_off_is_that_of_the_resource_estimate() -> None:
    shown = snapshot()
    found = grade_tonnage_curve(GradeTonnageQuery(cutoffs="9,8", probability=0.8), shown)
    assert [point.cutoff_ppb for point in found.curve] == [8.0, 9.0]
    for point in found.curve:
        other = estimate(ResourceQuery(cutoff_ppb=point.cutoff_ppb, probability=0.8), shown)
        assert point.area_m2.expected == pytest.approx(other.area_above_m2.expected, abs=0.02 * found.area_m2)
        assert point.area_m2.low == pytest.approx(other.area_above_m2.low, abs=0.02 * found.area_m2)
        assert point.area_m2.high == pytest.approx(other.area_above_m2.high, abs=0.02 * found.area_m2)


@pytest.mark.parametrize("level_ppb", [8.0, 3000.0])
def test_without_cut_offs_round_steps_cover_what_the_field_may_be(level_ppb: float) -> None:
    found = grade_tonnage_curve(GradeTonnageQuery(), snapshot(level_ppb=level_ppb))
    cutoffs = np.array([point.cutoff_ppb for point in found.curve])
    assert 5 <= len(cutoffs) <= MOST_STEPS + 1
    assert np.allclose(np.diff(cutoffs), np.diff(cutoffs)[0])
    areas = [point.area_m2.expected for point in found.curve]
    assert areas == sorted(areas, reverse=True)
    assert areas[0] > 0.98 * found.area_m2
    assert areas[-1] < 0.02 * found.area_m2


def test_above_all_that_the_field_may_be_there_is_no_ground_and_no_mean() -> None:
    (point,) = grade_tonnage_curve(GradeTonnageQuery(cutoffs="1000"), snapshot()).curve
    assert (point.area_m2.expected, point.area_m2.high, point.mass_kg_per_m.high) == (0.0, 0.0, 0.0)
    assert point.mean_ppb is None


def test_equal_queries_of_a_revision_have_equal_answers() -> None:
    shown = snapshot()
    assert grade_tonnage_curve(GradeTonnageQuery(), shown) == grade_tonnage_curve(GradeTonnageQuery(), shown)


def test_cut_offs_that_are_none_are_refused_and_so_is_a_map_without_a_belief() -> None:
    for text, why in (
        ("1e", "expected numbers"),
        ("--1", "expected numbers"),
        ("", "expected numbers"),
        ("-1", "from 0 ppb on"),
        ("nan", "from 0 ppb on"),
        ("1e999", "from 0 ppb on"),
        (",".join("1" * 41), "expected at most 40 abundances, got 41"),
    ):
        with pytest.raises(InvalidInput, match=why):
            grade_tonnage_curve(GradeTonnageQuery(cutoffs=text), snapshot())
    empty = MapSnapshot(**{**{f: getattr(snapshot(), f) for f in MapSnapshot.__dataclass_fields__}, "process": None})
    with pytest.raises(NotReady, match="no belief yet"):
        grade_tonnage_curve(GradeTonnageQuery(), empty)
