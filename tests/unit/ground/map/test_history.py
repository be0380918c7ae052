"""Earlier maps and the formats of answers."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from he3.constants import MOON_RADIUS_M
from he3.errors import InvalidInput, OutsideRegion
from he3.frames import SiteGrid
from he3.intervals import Intervals
from schemas.maps import MapAbout, MapBoxQuery, MapFormat, MapLayer, MapLayerQuery, MapPointQuery
from schemas.plans import Waypoint
from schemas.telemetry import SampleReport
from schemas.topics import MAP_BOX, MAP_LAYER, MAP_POINT
from services.ground.map import history
from services.ground.map.history import as_of, revisions, with_history
from services.ground.map.layers import box, exceedance, information_nats
from services.ground.map.rendering import ENTRY_BYTES, Renderer
from services.ground.map.service import answer
from services.ground.map.snapshot import MapSnapshot
from services.mission.mission_time import SECOND

GRID = SiteGrid(30, 40, 2.0)
START = 1_893_456_000 * SECOND  # 2030-01-01T00:00:00Z


def snapshot(revision: int, path: tuple[Waypoint, ...] = ((1.0, 2.0),)) -> MapSnapshot:
    rng = np.random.default_rng(revision)
    samples = tuple(
        SampleReport(
            sample_id=f"s{number}", round=1, plan_revision=1, x_m=3.0, y_m=4.0, depth_m=0.1, helium3_ppb=8.0 + number,
            noise_std_ppb=0.1, measured_at=START, driven_m=1.0,
        )
        for number in range(revision)
    )  # fmt: skip
    return MapSnapshot(
        grid=GRID, mean_ppb=rng.normal(8, 1, GRID.shape).astype(np.float32),
        std_ppb=rng.uniform(0.1, 1, GRID.shape).astype(np.float32), traversable=np.ones(GRID.shape, dtype=np.bool_),
        samples=samples, driven_path_m=path, planned_path_m=((1.0, 2.0), (5.0, 6.0)), plan_ends=None,
        revision=revision, mission_time_ns=START + revision * 60 * SECOND, score=None, score_history=(),
        origin_deg=(20.0, 30.0),
    )  # fmt: skip


def after(count: int) -> MapSnapshot:
    kept = with_history(snapshot(1), None)
    for revision in range(2, count + 1):
        kept = with_history(snapshot(revision), kept)
    return kept


def test_every_revision_is_held_once_and_a_new_path_alone_is_none() -> None:
    kept = with_history(replace(snapshot(3), driven_path_m=((9.0, 9.0),)), after(3))
    assert [each.revision for each in revisions(kept)] == [1, 2, 3]
    assert kept.driven_path_m == ((9.0, 9.0),)
    assert all(each.earlier == () for each in kept.earlier)


def test_equal_parts_of_revisions_are_held_once() -> None:
    kept = after(3)
    assert kept.traversable is kept.earlier[0].traversable
    assert kept.samples[0] is kept.earlier[0].samples[0]


def test_the_older_half_is_thinned_when_there_is_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history, "MAX_BYTES", 8 * 2 * snapshot(1).mean_ppb.nbytes)
    kept = after(40)
    held = [each.revision for each in revisions(kept)]
    assert len(held) <= 10
    assert held[-4:] == [37, 38, 39, 40]
    assert held[0] == 1


def test_intervals_count_as_much_as_the_maps_they_belong_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history, "MAX_BYTES", 24 * 2 * snapshot(1).mean_ppb.nbytes)
    intervals = Intervals(GRID, np.zeros((4, *GRID.shape), np.float32))
    kept = None
    for revision in range(1, 25):
        kept = with_history(replace(snapshot(revision), intervals=intervals), kept)
    assert kept is not None
    assert len(revisions(kept)) <= 10
    assert len(revisions(after(24))) == 24


def test_a_revision_or_a_time_names_the_last_map_that_is_not_later() -> None:
    kept = after(5)
    for when, revision in (
        (None, 5), ("3", 3), ("99", 5), ("2030-01-01T00:03:00Z", 3), ("2030-01-01T00:03:59.5", 3),
        (str(START + 2 * 60 * SECOND), 2), ("2031-01-01T00:00Z", 5),
    ):  # fmt: skip
        assert as_of(kept, when).revision == revision, when
    for when in ("0", "2029-12-31T23:59:59Z", "2030-13-01T00:00:00Z"):
        with pytest.raises(InvalidInput, match="as_of"):
            as_of(kept, when)
    reply = answer(MAP_POINT, MapPointQuery(x=3.0, y=4.0, as_of="2"), kept)
    assert reply.revision == 2
    assert reply.mean_ppb == float(snapshot(2).mean_ppb[2, 1])


def test_layers_have_the_closed_forms() -> None:
    assert exceedance(np.float32(8), np.float32(1), 8.0, None) == pytest.approx(0.5)
    assert exceedance(np.float32(9.6449), np.float32(1), 8.0, None) == pytest.approx(0.95, abs=1e-4)
    assert information_nats(np.float32(0.1), 0.1) == pytest.approx(0.5 * math.log(2))


def query(**changed: object) -> MapBoxQuery:
    return MapBoxQuery(**{"layer": MapLayer.MEAN, "x_min": 0.0, "y_min": 0.0, "x_max": 80.0, "y_max": 60.0, **changed})


def test_a_box_holds_the_values_at_its_cells_centres() -> None:
    shown = snapshot(1)
    assert np.array_equal(box(query(), shown).values, shown.mean_ppb)
    part = box(query(x_min=10.0, x_max=20.0, y_min=20.0, y_max=26.0), shown)
    assert np.array_equal(part.values, shown.mean_ppb[10:13, 5:10])
    finer = box(query(x_min=0.0, x_max=2.0, y_min=0.0, y_max=2.0, resolution_m=0.5), shown)
    assert finer.values.shape == (4, 4)
    assert (finer.values == shown.mean_ppb[0, 0]).all()


@pytest.mark.parametrize(
    ("changed", "error", "why"),
    [
        ({"x_max": 81.0}, OutsideRegion, "0..80 m east"),
        ({"x_min": 50.0, "x_max": 50.0}, InvalidInput, "x_min < x_max"),
        ({"resolution_m": 0.001}, InvalidInput, "at most 4000000 cells"),
        ({"layer": MapLayer.EXCEEDANCE}, InvalidInput, "expected threshold="),
        ({"threshold": 8.0}, InvalidInput, "expected threshold="),
        ({"layer": MapLayer.SAMPLES}, InvalidInput, "is a table"),
    ],
)
def test_impossible_boxes_are_refused(changed: dict[str, object], error: type[Exception], why: str) -> None:
    with pytest.raises(error, match=why):
        box(query(**changed), snapshot(1))


def test_formats_hold_the_same_numbers() -> None:
    render, shown = Renderer(), snapshot(2)
    made = {
        form: render(MAP_LAYER, MapLayerQuery(layer=MapLayer.MEAN, format=form), shown)
        for form in (MapFormat.NPY, MapFormat.CSV, MapFormat.PNG, MapFormat.TIFF)
    }
    payloads = {form: encoded.payload for form, encoded in made.items() if encoded is not None}
    assert np.array_equal(np.load(io.BytesIO(payloads[MapFormat.NPY])), shown.mean_ppb)
    table = np.loadtxt(io.BytesIO(payloads[MapFormat.CSV]), delimiter=",", skiprows=1)
    assert np.array_equal(table[:, :2], GRID.points())
    assert np.allclose(table[:, 2], shown.mean_ppb.ravel(), rtol=1e-6)
    from PIL import Image

    with Image.open(io.BytesIO(payloads[MapFormat.TIFF])) as picture:
        assert np.array_equal(np.array(picture)[::-1], shown.mean_ppb)
        scale, tie = picture.tag_v2[33550], picture.tag_v2[33922]
    stretch = 1 / math.cos(math.radians(20.0) + 30.0 / MOON_RADIUS_M)
    assert scale == pytest.approx((2.0 * stretch, 2.0, 0.0))
    assert tie[3] == pytest.approx(MOON_RADIUS_M * math.radians(30.0))
    assert tie[4] == pytest.approx(MOON_RADIUS_M * math.radians(20.0) + 60.0)
    with Image.open(io.BytesIO(payloads[MapFormat.PNG])) as picture:
        assert picture.size == (40, 30)
    about = MapAbout.model_validate_json(made[MapFormat.NPY].about if made[MapFormat.NPY] else b"")
    assert (about.low, about.high) == (float(shown.mean_ppb.min()), float(shown.mean_ppb.max()))


def test_equal_requests_of_one_revision_are_rendered_once_and_the_cache_is_bounded() -> None:
    render = Renderer(most_kept_bytes=3 * (30 * 40 * 4 + ENTRY_BYTES))
    request = MapLayerQuery(layer=MapLayer.STD, format=MapFormat.NPY)
    first = render(MAP_LAYER, request, snapshot(1))
    assert render(MAP_LAYER, request, snapshot(1)) is first
    for revision in range(2, 6):
        render(MAP_LAYER, request, snapshot(revision))
    assert render(MAP_LAYER, request, snapshot(1)) is not first
    assert render(MAP_BOX, query(), snapshot(1)) is None


def test_many_small_answers_are_bounded_in_number() -> None:
    render = Renderer(most_kept_bytes=10 * ENTRY_BYTES)
    for number in range(1, 100):
        assert render(MAP_LAYER, MapLayerQuery(layer=MapLayer.STD, format=MapFormat.NPY, step=30), snapshot(number))
    assert len(render._kept) < 10


def test_tables_come_as_json_and_csv_and_not_as_pictures() -> None:
    render, shown = Renderer(), snapshot(2)
    samples = render(MAP_LAYER, MapLayerQuery(layer=MapLayer.SAMPLES), shown)
    plan = render(MAP_LAYER, MapLayerQuery(layer=MapLayer.PLAN, format=MapFormat.CSV), shown)
    assert samples is not None
    assert plan is not None
    assert [row["sample_id"] for row in json.loads(samples.payload)["samples"]] == ["s0", "s1"]
    assert plan.payload.decode().splitlines() == [
        "path,x_m,y_m",
        "driven,1.0,2.0",
        "planned,1.0,2.0",
        "planned,5.0,6.0",
    ]
    with pytest.raises(InvalidInput, match="expected format json or csv"):
        render(MAP_LAYER, MapLayerQuery(layer=MapLayer.PLAN, format=MapFormat.PNG), shown)
