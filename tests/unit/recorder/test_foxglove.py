"""Messages in Foxglove's schemas: as Foxglove defines them, at the right places and times, and never at our cost."""

from __future__ import annotations

import base64
import io
import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from he3.errors import He3Error
from schemas.ground import KeepOutArea, KernelParameters, MapOverview, MapValues, MissionTrack
from schemas.maps import MapRegion
from schemas.plans import MissionPlan, PlannedSample, RoundPlan
from schemas.telemetry import EventKind, RoverEvent, RoverMode, RoverState, SampleReport
from schemas.topics import EVENT, MAP_OVERVIEW, PLAN, SAMPLE, STATE, Topic
from schemas.wire import Header, Wire
from services.console.map_export.placement import placed
from services.recorder.files import RecordingFile
from services.recorder.foxglove.derivation import CHANNELS, STEP_PPB, Derivation, Derived
from services.recorder.foxglove.path import DrivenPath
from services.recorder.foxglove.picture import picture
from services.recorder.foxglove.position import Site
from services.recorder.foxglove.schemas import NAMES, PACKAGE, descriptors
from services.recorder.node import RecorderNode
from services.recorder.reader import Recording
from services.recorder.sink import RecordingSink
from services.recorder.writer import RecordingWriter
from services.runtime.node import Effect, Level, LogRecord, Received

START = 1_900_000_000_000_000_000
MEAN = np.linspace(4.0, 9.0, 12, dtype="<f4").reshape(3, 4)
STD = np.linspace(0.2, 1.0, 12, dtype="<f4").reshape(3, 4)
OPEN = np.array([[1, 1, 1, 1], [1, 0, 1, 1], [1, 1, 1, 0]], dtype=np.uint8)


def header(number: int, source: str = "rover") -> Header:
    return Header(mission="m", source=source, incarnation=1, sequence=number, made_at=START + number * 10**9)


def state(x_m: float, y_m: float, heading_deg: float = 90.0) -> RoverState:
    return RoverState(
        mode=RoverMode.DRIVING, x_m=x_m, y_m=y_m, heading_deg=heading_deg, energy_wh=10.0, capacity_wh=20.0,
        driven_m=1.0, drilled_m=0.0, round=1, plan_revision=1, rounds_on_board=0, samples_done=0, queue_depth=0,
    )  # fmt: skip


def sample(number: int, x_m: float, y_m: float, ppb: float) -> SampleReport:
    return SampleReport(
        sample_id=f"s-{number}", round=1, plan_revision=1, x_m=x_m, y_m=y_m, depth_m=1.0, helium3_ppb=ppb,
        noise_std_ppb=0.1, measured_at=START + number * 10**9 - 5, driven_m=1.0,
    )  # fmt: skip


def text(layer: np.ndarray[Any, Any]) -> str:
    return base64.b64encode(layer.tobytes()).decode()


def overview(revision: int = 1, keep_outs: tuple[KeepOutArea, ...] = (), origin: bool = True) -> MapOverview:
    return MapOverview(
        revision=revision, samples=0, added=(), fits=0, mission_time_ns=START,
        kernel=KernelParameters(name="matern52", parameters={}, noise_std_ppb=0.1, mean_ppb=5.0, scale_ppb=1.0),
        rows=24, columns=32, resolution_m=2.0, origin_lat_deg=20.0 if origin else None,
        origin_lon_deg=30.0 if origin else None, checksum=0, step=8,
        values=MapValues(
            rows=3, columns=4, mean_base64=text(MEAN), std_base64=text(STD), traversable_base64=text(OPEN)
        ),
        keep_outs=keep_outs,
    )  # fmt: skip


def plan() -> MissionPlan:
    spot = PlannedSample(sample_id="s-1", x_m=30.0, y_m=10.0, depth_m=1.0)
    rounds = RoundPlan(round=1, path_m=((10.0, 10.0), (30.0, 10.0)), samples=(spot,), information_nats=1.0)
    return MissionPlan(revision=1, rounds=(rounds,), samples_known=0, planned_at=START)


def as_others_read(stream: io.BytesIO) -> dict[str, list[tuple[Any, Any]]]:
    """Messages and their records by topic, decoded with the schemas in the file alone."""
    stream.seek(0)
    found: dict[str, list[tuple[Any, Any]]] = {}
    for schema, channel, message, decoded in make_reader(
        stream, decoder_factories=[DecoderFactory()]
    ).iter_decoded_messages(topics=list(CHANNELS)):
        assert schema is not None
        assert schema.name == decoded.DESCRIPTOR.full_name == f"{PACKAGE}.{CHANNELS[channel.topic]}"
        found.setdefault(channel.topic, []).append((message, decoded))
    return found


def derived_from(*messages: tuple[Topic, Header, Wire]) -> dict[str, list[tuple[Any, Any]]]:
    """What other programs read of a recording of those messages, each received a second after it was made."""
    derivation = Derivation()
    return read_back([made for message in messages for made in derivation.of(*message)])


def read_back(messages: list[Derived]) -> dict[str, list[tuple[Any, Any]]]:
    stream = io.BytesIO()
    with RecordingWriter(stream, "m") as writer:
        for message in messages:
            writer.write_derived(message, message.made_at + 10**9)
    return as_others_read(stream)


@pytest.mark.parametrize("name", NAMES)
def test_the_schemas_are_those_of_foxgloves_own_package(name: str) -> None:
    messages = pytest.importorskip("foxglove.messages")
    assert descriptors(name) == getattr(messages, name).get_schema().data


def test_the_documentation_has_every_topic_with_its_schema_and_the_layout_no_other() -> None:
    docs = Path(__file__).parents[3] / "docs"
    rows = [line.split("|")[1:3] for line in (docs / "recordings.md").read_text().splitlines() if "foxglove." in line]
    table = {topic: row[1].strip(" `") for row in rows for topic in re.findall(r"`(/[\w/]+)`", row[0])}
    assert table == {topic: f"{PACKAGE}.{name}" for topic, name in CHANNELS.items()}
    layout = (docs / "foxglove-layout.json").read_text()
    assert set(re.findall(r'"(/[\w/]+)"', layout)) <= set(CHANNELS)
    assert json.loads(layout)["version"] == 1


def test_every_message_is_of_the_schema_of_its_topic_with_both_its_times() -> None:
    corners = ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0))
    found = derived_from(
        (MAP_OVERVIEW, header(1, "ground"), overview(keep_outs=(KeepOutArea(area_id="a", polygon_m=corners),))),
        (PLAN, header(2, "ground"), plan()),
        (STATE, header(3), state(10.0, 10.0)),
        (STATE, header(4), state(20.0, 10.0)),
        (SAMPLE, header(5), sample(5, 30.0, 10.0, 7.5)),
        (EVENT, header(6), RoverEvent(kind=EventKind.BLOCKED, at=START, x_m=30.0, y_m=10.0, detail="a rock")),
    )
    assert set(found) == set(CHANNELS)
    for topic, each in found.items():
        for message, decoded in each:
            assert message.log_time == message.publish_time + 10**9
            stamp = decoded.entities[0].timestamp if CHANNELS[topic] == "SceneUpdate" else decoded.timestamp
            assert stamp.ToNanoseconds() == message.publish_time
    (_, areas), (_, planned), (_, log) = found["/keep_outs"][0], found["/plan"][0], found["/log"][0]
    assert [(p.x, p.y) for p in areas.entities[0].lines[0].points] == list(corners)
    assert [(p.x, p.y) for p in planned.entities[0].lines[0].points] == [(10.0, 10.0), (30.0, 10.0)]
    assert (log.level, log.name, log.message) == (3, "rover", "blocked: a rock")


def test_the_grid_has_the_values_of_the_overview_on_blocks_of_its_cells_from_the_south_west_corner() -> None:
    found = derived_from((MAP_OVERVIEW, header(1, "ground"), overview()))
    for topic, dtype, expected in (("/map/mean", "<f4", MEAN), ("/map/std", "<f4", STD), ("/map/open", "u1", OPEN)):
        ((_, grid),) = found[topic]
        assert (grid.column_count, grid.cell_size.x, grid.cell_size.y, grid.frame_id) == (4, 16.0, 16.0, "site")
        assert (grid.pose.position.x, grid.pose.position.y, grid.pose.orientation.w) == (0.0, 0.0, 1.0)
        assert grid.row_stride == 4 * grid.cell_stride == 4 * np.dtype(dtype).itemsize
        values = np.frombuffer(grid.data, dtype=dtype).reshape(3, 4)
        assert np.abs(values.astype(float) - expected).max() <= STEP_PPB / 2


def test_the_rover_faces_its_heading_and_stands_where_it_reported() -> None:
    found = derived_from(
        (MAP_OVERVIEW, header(1, "ground"), overview()), (STATE, header(2), state(10.0, 20.0, heading_deg=30.0))
    )
    ((_, turned),), ((_, rover),), ((_, fix),) = (found[t] for t in ("/tf/rover", "/rover", "/rover/position"))
    assert (turned.translation.x, turned.translation.y, turned.parent_frame_id) == (10.0, 20.0, "site")
    yaw = 2 * math.atan2(turned.rotation.z, turned.rotation.w)
    assert (math.cos(yaw), math.sin(yaw)) == pytest.approx((math.sin(math.radians(30)), math.cos(math.radians(30))))
    assert rover.entities[0].cubes[0].pose.position.x == 10.0
    assert (fix.latitude, fix.longitude) == pytest.approx(Site(20.0, 30.0, 48.0).degrees((10.0, 20.0)))
    assert fix.heading == pytest.approx(math.radians(30.0))


def test_a_site_without_a_place_has_no_position_on_the_moon() -> None:
    found = derived_from(
        (MAP_OVERVIEW, header(1, "ground"), overview(origin=False)), (STATE, header(2), state(1.0, 2.0))
    )
    assert not {"/tf/moon", "/rover/position"} & set(found)


def test_repeated_and_overtaken_messages_add_nothing() -> None:
    derivation = Derivation()
    messages: list[tuple[Topic, Header, Wire]] = [
        (SAMPLE, header(5), sample(5, 30.0, 10.0, 7.5)),
        (EVENT, header(6), RoverEvent(kind=EventKind.PARKED, at=START, x_m=30.0, y_m=10.0)),
        (PLAN, header(7, "ground"), plan()),
        (MAP_OVERVIEW, header(8, "ground"), overview()),
        (STATE, header(9), state(40.0, 10.0)),
    ]
    for topic, head, body in messages:
        assert list(derivation.of(topic, head, body))
        assert not list(derivation.of(topic, head.model_copy(update={"repetition": 1}), body))
    assert not list(derivation.of(STATE, header(8), state(39.0, 10.0)))


def test_each_message_of_the_samples_has_all_samples_so_far() -> None:
    found = derived_from(*((SAMPLE, header(n), sample(n, 10.0 * n, 5.0, 6.0 + n)) for n in (1, 2, 3)))
    _, last = found["/samples"][-1]
    assert [field.name for field in last.fields] == ["x", "y", "z", "helium3_ppb"]
    points = np.frombuffer(last.data, dtype="<f4").reshape(-1, 4)
    assert points[:, [0, 1, 3]].tolist() == [[10.0, 5.0, 7.0], [20.0, 5.0, 8.0], [30.0, 5.0, 9.0]]
    assert [update.entities[0].id for _, update in found["/samples/markers"]] == ["s-1", "s-2", "s-3"]


# --- the path ---------------------------------------------------------------------------------------------------------


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=2, max_size=150), st.randoms())
def test_the_whole_path_and_the_new_part_go_through_the_reported_places_in_the_order_of_time(
    corners: list[tuple[int, int]], order: Any
) -> None:
    places = [(float(x), float(y)) for x, y in corners]
    reports = list(enumerate(places))
    for _ in range(3):  # some come late, as after a time without contact
        late = order.randrange(len(reports))
        reports.insert(min(len(reports), late + order.randrange(5)), reports.pop(late))
    path, whole = DrivenPath(), list[tuple[float, float]]()
    for time, place in reports:
        path.add(time, place)
        whole = list(path.whole() or whole)
    shown = whole + list(path.new[bool(whole) :])
    walked = iter(zip(shown, shown[1:] or shown, strict=False))
    leg = next(walked)
    for place in places:
        while math.dist(leg[0], place) + math.dist(place, leg[1]) > math.dist(*leg) + 1e-6:
            leg = next(walked)  # it ends, and the test fails, if no later leg has the place


def test_the_file_grows_with_the_path_and_not_with_its_square() -> None:
    path, written = DrivenPath(), 0
    for number in range(20_000):
        path.add(number, (float(number), float(number % 2)))
        written += len(path.whole() or ()) + len(path.new)
    assert written < 500 * 20_000


# --- where the site lies on the Moon ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("latitude", "longitude"), [(20.19, 30.77), (-61.0, -179.999), (-89.5, 130.0), (84.0, 10.0)])
def test_positions_are_those_of_the_exported_maps(latitude: float, longitude: float) -> None:
    try:
        placement = placed(
            MapRegion(
                name="r", title="r", location="r", field_seed=None, provenance="", rows=900, columns=800,
                resolution_m=2.0, origin_lat_deg=latitude, origin_lon_deg=longitude, crs="", origin_x_m=None,
                origin_y_m=None, layers=(),
            )
        )  # fmt: skip
    except He3Error as error:
        pytest.skip(str(error))
    site = Site(latitude, longitude, 1800.0)
    for place in ((0.0, 0.0), (1600.0, 0.0), (0.0, 1800.0), (1234.5, 678.9)):
        expected = placement.degrees(np.array([place]))
        assert expected is not None
        found = site.degrees(place)
        assert found[0] == pytest.approx(expected[0][1], abs=1e-7)  # 3 mm
        turn = (found[1] - expected[0][0] + 180.0) % 360.0 - 180.0
        assert abs(turn) * math.cos(math.radians(found[0])) < 1e-7
        assert -180.0 <= found[1] < 180.0


@pytest.mark.parametrize(("latitude", "longitude"), [(0.0, 0.0), (20.0, 30.0), (-89.0, -120.0)])
def test_the_moons_frame_lies_in_the_sites_so_that_the_corner_has_its_place_on_the_sphere(
    latitude: float, longitude: float
) -> None:
    site = Site(latitude, longitude, 500.0)
    x, y, z, w = site.moon_turn
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    phi, lam = math.radians(latitude), math.radians(longitude)
    up = np.array([math.cos(phi) * math.cos(lam), math.cos(phi) * math.sin(lam), math.sin(phi)])
    east = np.array([-math.sin(lam), math.cos(lam), 0.0])
    assert turned @ (1_737_400.0 * up) + site.moon_centre_m == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert turned @ np.column_stack((east, np.cross(up, east), up)) == pytest.approx(np.eye(3), abs=1e-12)


# --- the picture ------------------------------------------------------------------------------------------------------


def test_the_picture_is_north_up_with_closed_ground_dark() -> None:
    images = pytest.importorskip("PIL.Image")
    data = picture(MEAN, OPEN > 0)
    assert data is not None
    image = images.open(io.BytesIO(data)).convert("RGB")
    assert image.size == (256, 192)
    lowest, highest, closed = (0x44, 0x01, 0x54), image.getpixel((150, 10)), (40, 24, 24)
    assert image.getpixel((10, 180)) == lowest  # south-west
    assert sum(highest) > sum(lowest)
    assert image.getpixel((250, 10)) == image.getpixel((100, 96)) == closed


def test_a_recorder_without_pillow_makes_no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PIL.Image", None)
    assert picture(MEAN, OPEN > 0) is None
    assert "/map/picture" not in derived_from((MAP_OVERVIEW, header(1, "ground"), overview()))


# --- never at the cost of our own -------------------------------------------------------------------------------------


class Raw:
    """A raw file with room for a number of bytes."""

    def __init__(self, path: Path, room: int = 10**9) -> None:
        self.path, self.room, self.content = path, room, bytearray()

    def write(self, data: bytearray, /) -> int:
        if len(data) > self.room:
            raise OSError(28, "No space left on device")
        self.content += data
        self.room -= len(data)
        return len(data)

    def close(self) -> None:
        self.path.write_bytes(self.content)


def test_a_fault_in_foxgloves_messages_costs_none_of_ours_and_is_said_once(tmp_path: Path) -> None:
    def failing(topic: Topic, head: Header, body: Wire) -> list[Derived]:
        raise ZeroDivisionError(f"at {head.sequence}")

    effects: list[Effect] = []
    path = tmp_path / "mission.mcap"
    with RecordingSink(RecordingFile(path, Raw(path)), "m") as sink:
        node = RecorderNode(sink, 1.0, failing)
        for number in range(5):
            effects += node.handle(Received(STATE, header(number), state(1.0, 2.0)), START + number)
    said = [each for each in effects if isinstance(each, LogRecord)]
    assert said == [LogRecord(Level.ERROR, "messages for Foxglove are missing: tm/state: ZeroDivisionError: at 0")]
    recording = Recording(path)
    assert len(list(recording.messages())) == 5
    assert recording.whole


def test_while_the_disk_is_full_foxgloves_messages_are_left_out_and_ours_wait(tmp_path: Path) -> None:
    path = tmp_path / "mission.mcap"
    raw = Raw(path, room=1000)
    with RecordingSink(RecordingFile(path, raw), "m") as sink:
        node = RecorderNode(sink, 1.0, Derivation().of)
        for number in range(5):
            list(node.handle(Received(STATE, header(number), state(1.0, 2.0)), START + number))
            sink.flush()
        assert sink.failure is not None
        raw.room = 10**9
    assert sink.problem is None
    recording = Recording(path)
    assert len(list(recording.messages())) == 5
    assert recording.foreign["/rover"] < 5
    assert recording.whole


def test_who_joins_late_gets_the_samples_the_path_and_the_plan_of_the_grounds_account() -> None:
    track = MissionTrack(
        samples=(sample(1, 10.0, 5.0, 7.0), sample(2, 20.0, 5.0, 8.0)),
        driven_path_m=((0.0, 0.0), (10.0, 5.0), (20.0, 5.0)), planned_path_m=((20.0, 5.0), (30.0, 9.0)),
        score_history=(),
    )  # fmt: skip
    derivation = Derivation()
    first = [*derivation.of_track(track, START), *derivation.of(STATE, header(9), state(25.0, 7.0))]
    found = read_back(first)
    assert len(np.frombuffer(found["/samples"][-1][1].data, dtype="<f4")) == 8
    assert len(found["/samples/markers"]) == 2
    assert points_of(found["/rover/path"][-1][1]) == [(0.0, 0.0), (10.0, 5.0), (20.0, 5.0)]
    assert points_of(found["/rover"][-1][1]) == [(20.0, 5.0), (25.0, 7.0)]
    assert points_of(found["/plan"][-1][1]) == [(20.0, 5.0), (30.0, 9.0)]
    again = read_back(list(derivation.of_track(track, START)))
    assert set(again) == {"/plan"}


def points_of(update: Any) -> list[tuple[float, float]]:
    return [(point.x, point.y) for point in update.entities[0].lines[0].points]
