"""Replies to operators' queries, and the time that they take."""

from __future__ import annotations

import base64
from dataclasses import replace
from time import process_time

import numpy as np
import pytest
from pydantic import ValidationError

from he3.errors import InvalidInput, NotFound, NotReady, OutsideRegion
from he3.frames import SiteGrid
from he3.gp import GaussianProcess, Hyperparameters
from he3.intervals import Intervals
from he3.kernels import kernel_from
from schemas.commands import NoParameters
from schemas.ground import KeepOutArea
from schemas.maps import (
    CrossValidationQuery,
    GradeTonnageQuery,
    MapBoxQuery,
    MapLayer,
    MapLayerQuery,
    MapPointQuery,
    MapRegion,
    MapScore,
    MapTrackQuery,
    RealisationsQuery,
    RegionLayer,
    ResourceQuery,
)
from schemas.telemetry import SampleReport
from schemas.topics import (
    GROUND_STATUS,
    MAP_BOX,
    MAP_CROSS_VALIDATION,
    MAP_GRADE_TONNAGE,
    MAP_HISTORY,
    MAP_LAYER,
    MAP_POINT,
    MAP_REALISATIONS,
    MAP_REGION,
    MAP_RESOURCE,
    MAP_SCORE,
    TRACK,
)
from services.ground.map.service import MAP_TOPICS, answer, layer, point, score
from services.ground.map.snapshot import MapSnapshot
from services.ground.scoring import Scorer
from tests.waiting import expect_within

GRID = SiteGrid(40, 50, 2.0)
REGION = MapRegion(
    name="place", title="A place", location="t1", field_seed=None, provenance="p" * 900, rows=40, columns=50,
    resolution_m=2.0, origin_lat_deg=None, origin_lon_deg=None, crs="", origin_x_m=None, origin_y_m=None,
    layers=(RegionLayer(layer="elevation_m", kind="real", source="s" * 900, citation="c" * 900),),
)  # fmt: skip
KEEP_OUT = KeepOutArea(area_id="scenario-1", polygon_m=((1.0, 1.0), (9.0, 1.0), (5.0, 8.0)))


def snapshot(scored: MapScore | None = None) -> MapSnapshot:
    rng = np.random.default_rng(2)
    mean = rng.normal(8, 1, GRID.shape).astype(np.float32)
    std = rng.uniform(0.1, 1, GRID.shape).astype(np.float32)
    traversable = rng.random(GRID.shape) > 0.2
    return MapSnapshot(
        grid=GRID, mean_ppb=mean, std_ppb=std, traversable=traversable, samples=(), driven_path_m=((1.0, 2.0),),
        planned_path_m=(), plan_ends=None, revision=7, mission_time_ns=123, score=scored, score_history=(),
        process=GaussianProcess(Hyperparameters(kernel_from("matern52"), 0.1, 8.0, 1.0)),
        provenance=REGION.provenance, region=REGION, keep_outs=(KEEP_OUT,),
    )  # fmt: skip


def sampled(shown: MapSnapshot) -> MapSnapshot:
    """That map with five samples in its belief."""
    samples = tuple(
        SampleReport(
            sample_id=f"s{k}", round=1, plan_revision=1, x_m=20.0 * k + 1.0, y_m=10.0 * k + 1.0, depth_m=0.1,
            helium3_ppb=8.0 + 0.1 * (-1) ** k, noise_std_ppb=0.1, measured_at=k, driven_m=0.0,
        )
        for k in range(5)
    )  # fmt: skip
    assert shown.process is not None
    process = shown.process.condition([(s.x_m, s.y_m) for s in samples], [s.helium3_ppb for s in samples])
    return replace(shown, samples=samples, process=process)


def test_a_point_is_that_of_the_cell_that_holds_it() -> None:
    shown = snapshot()
    for x, y, row, column in ((0.0, 0.0, 0, 0), (3.9, 2.0, 1, 1), (100.0, 80.0, 39, 49), (99.99, 0.0, 0, 49)):
        reply = point(MapPointQuery(x=x, y=y), shown)
        assert reply.mean_ppb == float(shown.mean_ppb[row, column])
        assert reply.std_ppb == float(shown.std_ppb[row, column])
        assert reply.traversable is bool(shown.traversable[row, column])
        assert (reply.x_m, reply.y_m, reply.revision, reply.mission_time_ns) == (x, y, 7, 123)


def test_a_point_has_the_ends_of_its_intervals_of_a_normal_belief_and_of_another() -> None:
    shown = snapshot()
    normal = point(MapPointQuery(x=4.5, y=3.0), shown)
    assert normal.high_68_ppb == pytest.approx(normal.mean_ppb + normal.std_ppb)
    assert normal.low_95_ppb == pytest.approx(normal.mean_ppb - 2.0 * normal.std_ppb)
    ends = np.stack([np.full(GRID.shape, end, np.float32) for end in (-2.5, -0.5, 0.75, 3.0)])
    other = point(MapPointQuery(x=4.5, y=3.0), replace(shown, intervals=Intervals(GRID, ends)))
    assert other.low_68_ppb == pytest.approx(other.mean_ppb - 0.5 * other.std_ppb)
    assert other.high_95_ppb == pytest.approx(other.mean_ppb + 3.0 * other.std_ppb)


def test_no_interval_reaches_below_zero() -> None:
    shown = snapshot()
    told = point(MapPointQuery(x=4.5, y=3.0), replace(shown, mean_ppb=shown.mean_ppb - 8.0))
    assert told.mean_ppb - 2.0 * told.std_ppb < 0.0
    assert told.low_95_ppb == 0.0
    assert told.high_95_ppb == max(0.0, told.mean_ppb + 2.0 * told.std_ppb)


def test_the_probability_beyond_an_end_of_an_interval_is_that_of_the_interval() -> None:
    ends = np.stack([np.full(GRID.shape, end, np.float32) for end in (-2.5, -0.5, 0.75, 3.0)])
    shown = replace(snapshot(), intervals=Intervals(GRID, ends))
    ask = MapPointQuery(x=4.5, y=3.0)
    told = point(ask, shown)
    for end, above in (
        (told.low_95_ppb, 0.97725), (told.low_68_ppb, 0.84134), (told.high_68_ppb, 0.15866), (told.high_95_ppb, 0.02275)
    ):  # fmt: skip
        assert point(ask.model_copy(update={"threshold": end}), shown).exceedance == pytest.approx(above, abs=1e-4)
        cells = layer(MapLayerQuery(layer=MapLayer.EXCEEDANCE, threshold=end), shown)
        values = np.frombuffer(base64.b64decode(cells.data_base64), dtype=cells.dtype).reshape(GRID.shape)
        assert values[1, 2] == pytest.approx(above, abs=1e-4)
        assert np.all((values >= 0.0) & (values <= 1.0))


def test_an_abundance_below_zero_is_no_threshold_and_no_cut_off() -> None:
    """The belief is normal there, but the field is not: it would be above with a probability of less than 1."""
    for query in (
        lambda ppb: MapPointQuery(x=4.5, y=3.0, threshold=ppb),
        lambda ppb: MapLayerQuery(layer=MapLayer.EXCEEDANCE, threshold=ppb),
        lambda ppb: ResourceQuery(cutoff_ppb=ppb),
    ):
        assert query(0.0)
        with pytest.raises(ValidationError, match="greater than or equal to 0"):
            query(-0.1)


@pytest.mark.parametrize(("x", "y"), [(-0.01, 5.0), (100.01, 5.0), (5.0, 80.5)])
def test_a_point_outside_the_region_is_refused_with_its_bounds(x: float, y: float) -> None:
    with pytest.raises(OutsideRegion, match=r"expected a place within 0\.\.100 m east and 0\.\.80 m north, got"):
        point(MapPointQuery(x=x, y=y), snapshot())


@pytest.mark.parametrize("step", [1, 3, 500])
def test_a_layer_comes_whole_or_thinned_out_row_0_in_the_south(step: int) -> None:
    shown = snapshot()
    reply = layer(MapLayerQuery(layer=MapLayer.MEAN, step=step), shown)
    values = np.frombuffer(base64.b64decode(reply.data_base64), dtype=reply.dtype).reshape(reply.rows, reply.columns)
    assert np.array_equal(values, shown.mean_ppb[::step, ::step])
    assert reply.resolution_m == 2.0 * step


def test_traversability_comes_as_ones_and_zeros() -> None:
    shown = snapshot()
    reply = layer(MapLayerQuery(layer=MapLayer.TRAVERSABLE), shown)
    values = np.frombuffer(base64.b64decode(reply.data_base64), dtype=reply.dtype).reshape(reply.rows, reply.columns)
    assert np.array_equal(values.astype(bool), shown.traversable)
    assert reply.dtype == "|u1"


def test_every_map_topic_is_answered_with_the_reply_of_its_row_in_the_table() -> None:
    reference = np.full(GRID.shape, 8.0)
    shown = snapshot()
    shown = sampled(snapshot(Scorer(reference).score(shown.mean_ppb, shown.std_ppb, 7, 0, 123)))
    requests = {
        MAP_POINT: MapPointQuery(x=1.0, y=1.0),
        MAP_LAYER: MapLayerQuery(layer=MapLayer.STD),
        MAP_SCORE: NoParameters(),
        MAP_CROSS_VALIDATION: CrossValidationQuery(),
        MAP_GRADE_TONNAGE: GradeTonnageQuery(),
        MAP_REALISATIONS: RealisationsQuery(count=2),
        TRACK: MapTrackQuery(),
        MAP_BOX: MapBoxQuery(layer=MapLayer.MEAN, x_min=0.0, y_min=0.0, x_max=10.0, y_max=10.0),
        MAP_RESOURCE: ResourceQuery(),
        MAP_HISTORY: NoParameters(),
        MAP_REGION: NoParameters(),
    }
    assert set(requests) == set(MAP_TOPICS)
    for topic, request in requests.items():
        assert type(answer(topic, request, shown)) is topic.reply


def test_each_sample_comes_with_what_the_others_say_of_it() -> None:
    shown = sampled(snapshot())
    assert shown.process is not None
    told = answer(MAP_CROSS_VALIDATION, CrossValidationQuery(), shown)
    others = [k for k in range(5) if k != 2]
    belief = GaussianProcess(shown.process.hyperparameters).condition(
        [(shown.samples[k].x_m, shown.samples[k].y_m) for k in others], [shown.samples[k].helium3_ppb for k in others]
    )
    mean, std = belief.predict([(41.0, 21.0)])
    third = told.samples[2]
    assert (third.sample_id, third.x_m, third.y_m, third.measured_ppb) == ("s2", 41.0, 21.0, 8.1)
    assert third.expected_ppb == pytest.approx(mean[0])
    assert third.std_ppb == pytest.approx(np.hypot(std[0], 0.1))
    assert third.score == pytest.approx((8.1 - third.expected_ppb) / third.std_ppb, abs=1e-6)
    assert told.rmse_ppb == pytest.approx(
        np.sqrt(np.mean([(each.measured_ppb - each.expected_ppb) ** 2 for each in told.samples]))
    )
    assert (told.revision, told.mission_time_ns) == (7, 123)


def test_realisations_are_fields_of_the_site_and_the_same_at_each_query_of_a_revision() -> None:
    shown = sampled(snapshot())
    told = answer(MAP_REALISATIONS, RealisationsQuery(count=3), shown)
    assert (told.count, told.rows, told.columns, told.resolution_m) == (3, 40, 50, 2.0)
    assert (told.revision, told.samples, told.mission_time_ns) == (7, 5, 123)
    fields = np.frombuffer(base64.b64decode(told.data_base64), "<f4").reshape(3, 40, 50)
    assert np.isfinite(fields).all()
    assert np.abs(fields[:, 10, 20] - 8.1).max() < 0.5, "the cell of the third sample"
    assert fields.std(axis=0).mean() > 0.3
    assert answer(MAP_REALISATIONS, RealisationsQuery(count=3), shown) == told
    later = answer(MAP_REALISATIONS, RealisationsQuery(count=3), replace(shown, revision=8))
    assert later.data_base64 != told.data_base64
    with pytest.raises(NotReady, match="no belief yet to draw from"):
        answer(MAP_REALISATIONS, RealisationsQuery(), replace(shown, process=None))


def test_without_samples_or_with_one_that_the_belief_does_not_have_yet_nothing_is_cross_validated() -> None:
    with pytest.raises(NotReady, match="there are no samples yet"):
        answer(MAP_CROSS_VALIDATION, CrossValidationQuery(), snapshot())
    shown = sampled(snapshot())
    with pytest.raises(NotReady, match="does not have all samples yet"):
        answer(MAP_CROSS_VALIDATION, CrossValidationQuery(), replace(shown, samples=shown.samples[:4]))


def test_the_track_has_the_keep_outs_and_the_region_its_whole_provenance() -> None:
    shown = snapshot()
    assert answer(TRACK, MapTrackQuery(), shown).keep_outs == (KEEP_OUT,)
    assert answer(MAP_REGION, NoParameters(), shown) == REGION
    assert answer(MAP_HISTORY, NoParameters(), shown).site.provenance == REGION.provenance
    with pytest.raises(NotFound, match="no account of the region"):
        answer(MAP_REGION, NoParameters(), replace(shown, region=None))


def test_what_cannot_be_answered_is_refused_in_one_line() -> None:
    with pytest.raises(NotReady, match="none yet"):
        answer(MAP_POINT, MapPointQuery(x=1.0, y=1.0), None)
    with pytest.raises(InvalidInput, match="expected a query of earth/map/point"):
        answer(GROUND_STATUS, NoParameters(), snapshot())
    with pytest.raises(NotFound, match="no reference field"):
        score(snapshot())


def test_the_score_agrees_with_direct_arithmetic() -> None:
    shown = snapshot()
    truth = np.random.default_rng(5).normal(8, 1, GRID.shape)
    got = Scorer(truth).score(shown.mean_ppb, shown.std_ppb, 3, 11, 99)
    miss = np.abs(shown.mean_ppb - truth)
    assert got.rmse_ppb == pytest.approx(float(np.sqrt(np.mean(miss**2))), rel=1e-6)
    assert got.coverage_68 == pytest.approx(float(np.mean(miss <= shown.std_ppb)), abs=1e-3)
    assert got.coverage_95 == pytest.approx(float(np.mean(miss <= 2 * shown.std_ppb)), abs=1e-3)
    assert got.mean_std_ppb == pytest.approx(float(shown.std_ppb.mean(dtype=float)))
    assert (got.revision, got.samples, got.mission_time_ns) == (3, 11, 99)


def test_the_coverage_of_a_belief_that_is_not_normal_is_that_of_its_own_intervals() -> None:
    shown = snapshot()
    truth = shown.mean_ppb + 1.5 * shown.std_ppb
    known = np.arange(GRID.rows * GRID.columns).reshape(GRID.shape) % 3 > 0
    ends = np.stack([np.full(GRID.shape, end, np.float32) for end in (-2.0, -1.0, 1.0, 2.0)])
    ends[2, :, ::2], ends[3, ::4] = 1.6, 1.4
    got = Scorer(truth, known).score(shown.mean_ppb, shown.std_ppb, 3, 11, 99, ends)
    assert got.coverage_68 == pytest.approx(float((ends[2] > 1.5)[known].mean()))
    assert got.coverage_95 == pytest.approx(float((ends[3] > 1.5)[known].mean()))


def test_cells_without_a_reference_are_not_scored() -> None:
    shown, random = snapshot(), np.random.default_rng(5)
    truth = shown.mean_ppb + random.normal(0.0, 1.0, shown.mean_ppb.shape)
    known = random.random(truth.shape) < 0.7
    wrong = np.where(known, truth, 1e5)
    got = Scorer(wrong, known).score(shown.mean_ppb, shown.std_ppb, 3, 11, 99)
    miss = np.abs(shown.mean_ppb - truth)[known]
    assert got.rmse_ppb == pytest.approx(float(np.sqrt((miss**2).mean())), rel=1e-5)
    assert got.coverage_68 == pytest.approx(float((miss <= shown.std_ppb[known]).mean()))
    assert got.mean_std_ppb == pytest.approx(float(shown.std_ppb[known].mean()), rel=1e-6)


def test_the_ground_within_reach_has_a_score_of_its_own() -> None:
    shown, random = snapshot(), np.random.default_rng(5)
    truth = shown.mean_ppb + random.normal(0.0, 1.0, shown.mean_ppb.shape)
    known, reach = random.random(truth.shape) < 0.9, random.random(truth.shape) < 0.6
    got = Scorer(truth, known, reach).score(shown.mean_ppb, shown.std_ppb, 3, 11, 99)
    everywhere = Scorer(truth, known).score(shown.mean_ppb, shown.std_ppb, 3, 11, 99)
    assert got.model_copy(update={"within_reach": None}) == everywhere
    assert got.within_reach is not None
    both = known & reach
    miss, std = np.abs(shown.mean_ppb - truth)[both], shown.std_ppb[both]
    assert got.within_reach.share == pytest.approx(both.sum() / known.sum())
    assert got.within_reach.rmse_ppb == pytest.approx(float(np.sqrt((miss**2).mean())), rel=1e-5)
    assert got.within_reach.coverage_68 == pytest.approx(float((miss <= std).mean()), abs=1e-3)
    assert got.within_reach.coverage_95 == pytest.approx(float((miss <= 2 * std).mean()), abs=1e-3)


@pytest.mark.parametrize("all_or_none", [True, False])
def test_where_every_cell_or_none_is_within_reach_there_is_no_second_score(all_or_none: bool) -> None:
    shown = snapshot()
    scorer = Scorer(np.zeros(GRID.shape), within_reach=np.full(GRID.shape, all_or_none))
    assert scorer.score(shown.mean_ppb, shown.std_ppb, 3, 11, 99).within_reach is None


def test_a_score_of_maps_of_another_shape_is_refused() -> None:
    with pytest.raises(InvalidInput, match="expected maps of shape"):
        Scorer(np.zeros((3, 3))).score(np.zeros((4, 4), np.float32), np.zeros((4, 4), np.float32), 1, 0, 0)


def test_a_point_is_answered_in_a_fraction_of_a_millisecond() -> None:
    shown, request = snapshot(), MapPointQuery(x=33.0, y=44.0)
    best_s = min(_time_of(lambda: point(request, shown)) for _ in range(20))
    expect_within(200e-6, best_s, "the answer for a point", process_time)


def _time_of(call: object) -> float:
    begin = process_time()
    for _ in range(20):
        call()  # type: ignore[operator]
    return (process_time() - begin) / 20
