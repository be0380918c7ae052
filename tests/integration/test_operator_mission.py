"""Operators of a mission in separate processes: queries, the feed, the client, the shell, the notebook."""

from __future__ import annotations

import base64
import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message_factory import GetMessages

from he3.errors import He3Error, InvalidInput
from schemas.maps import MapAbout
from schemas.topics import Side
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import Endpoints, free_endpoints
from services.console.launch.launcher import Launcher
from services.runtime.transport.opening import open_client
from tests.processes import he3 as he3_command
from tests.processes import he3_here, start
from tests.waiting import PATIENCE_S, until

MISSION, RATE = "t1-paper", 120.0
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Launcher, Endpoints]]:
    endpoints = free_endpoints()
    quick = ("--set", "rover.drill_s_per_m=600.0", "--set", "rover.analysis_s=30.0", "--set", "rover.speed_m_s=2.0")
    scenario = ROOT / "deploy" / "scenarios" / f"{MISSION}.toml"
    logs = tmp_path_factory.mktemp("logs")
    with Launcher(scenario, endpoints, ("--rate", str(RATE), *quick), logs=logs) as launcher:
        with MissionClient.when_up(endpoints.earth, MISSION, launcher.check) as client:
            until(lambda: quietly(lambda: len(client.samples()) >= 2), "two samples")
        yield launcher, endpoints


@pytest.fixture
def client(running: tuple[Launcher, Endpoints]) -> Iterator[MissionClient]:
    with MissionClient(running[1].earth, MISSION) as joined:
        yield joined


def quietly(what: Callable[[], Any]) -> Any:
    try:
        return what()
    except He3Error:
        return None


def test_a_stock_zenoh_client_asks_with_a_selector_and_gets_json_arrays_and_pictures(
    running: tuple[Launcher, Endpoints],
) -> None:
    session = open_client(Side.EARTH, running[1].earth)

    def get(selector: str) -> tuple[str, bytes, bytes]:
        (reply,) = list(session.get(f"he3/{MISSION}/{selector}", timeout=PATIENCE_S))
        assert reply.ok is not None, reply.err.payload.to_string()
        about = b"" if reply.ok.attachment is None else reply.ok.attachment.to_bytes()
        return str(reply.ok.encoding), reply.ok.payload.to_bytes(), about

    try:
        encoding, payload, _ = get("earth/map/point?x=120;y=340;threshold=8")
        point = json.loads(payload)
        assert encoding == "application/json"
        assert 0 <= point["exceedance"] <= 1
        encoding, payload, about = get("earth/map/layer?layer=std;format=npy;as_of=1")
        values, shown = np.load(io.BytesIO(payload)), MapAbout.model_validate_json(about)
        assert (encoding, values.dtype, values.shape) == ("application/x-npy", np.float32, (500, 500))
        assert (shown.revision, shown.samples, shown.unit) == (1, 0, "ppb")
        for form, magic in (("png", b"\x89PNG"), ("tiff", b"II*\0"), ("csv", b"x_m,y_m,mean_ppb\n100.5,100.5,")):
            box = "x_min=100;y_min=100;x_max=120;y_max=110"
            _, payload, _ = get(f"earth/map/box?layer=mean;{box};format={form}")
            assert payload.startswith(magic)
        # A process that answers in its main loop replies in the same form.
        for selector, key in (
            ("earth/link/set?direction=down", "conditions"),
            ("earth/ground/commands", "commands"),
            (f"earth/clock/set?rate={json.loads(get('earth/clock')[1])['body']['rate']}", "rate"),
        ):
            assert key in json.loads(get(selector)[1])
        for wrong, why in (
            ("point?x=120;y=900", "expected a place within 0..500 m"),
            ("layer?layer=gold", "input should be"),
            ("layer?layer=exceedance", "expected threshold="),
            ("box?layer=mean;x_min=0;y_min=0;x_max=500;y_max=500;resolution_m=0.01", "expected at most 4000000 cells"),
            ("point?x=1;y=1;as_of=yesterday", "as_of"),
            ("resource?polygon=1,1,2,2", "3 to 256 corners"),
        ):
            (reply,) = list(session.get(f"he3/{MISSION}/earth/map/{wrong}", timeout=PATIENCE_S))
            refusal = json.loads(reply.err.payload.to_bytes())
            assert why in refusal["error"]
            assert refusal["code"] in ("invalid_input", "outside_region")
    finally:
        session.close()


def test_a_point_a_box_and_a_layer_of_one_revision_say_the_same(client: MissionClient) -> None:
    revision = client.history().revisions[-1].revision
    layer = client.layer("mean", as_of=revision)
    box = client.box("mean", (100, 200), (300, 350), as_of=revision)
    assert np.array_equal(box.values, layer.values[300:350, 100:200])
    assert (box.x_m[0], box.y_m[0], box.extent) == (100.5, 300.5, (100.0, 200.0, 300.0, 350.0))
    coarse = client.box("std", (0, 500), (0, 500), resolution_m=50, as_of=revision)
    assert np.array_equal(coarse.values, client.layer("std", as_of=revision).values[25::50, 25::50])
    point = client.point(150.2, 320.9, threshold=8.0, as_of=revision)
    assert point.mean_ppb == layer.values[320, 150]
    exceedance = client.layer("exceedance", threshold=8.0, as_of=revision)
    assert point.exceedance == pytest.approx(exceedance.values[320, 150], abs=1e-5)
    information = client.layer("information", as_of=revision)
    assert point.information_nats == pytest.approx(information.values[320, 150], rel=1e-4)


def test_the_feed_ends_with_the_grounds_arrays(client: MissionClient) -> None:
    seen = 0
    for current in client.maps(timeout_s=PATIENCE_S):
        seen += 1
        for name, values in (("mean", current.mean_ppb), ("std", current.std_ppb)):
            assert client.layer(name, as_of=current.revision).values.tobytes() == values.tobytes()
        assert current.traversable.shape == (500, 500)
        if seen == 3:
            break
    assert seen == 3


def test_samples_come_as_a_table_and_news_as_they_happen(client: MissionClient) -> None:
    table = client.samples()
    assert len(table) >= 2
    assert np.isfinite(table.helium3_ppb).all()
    assert len(client.samples(as_of=1)) == 0
    checked = client.cross_validation()
    assert [each.sample_id for each in checked.samples][: len(table)] == table.sample_id.tolist()
    assert client.cross_validation(checked.revision) == checked
    with pytest.raises(He3Error, match="there are no samples yet"):
        client.cross_validation(as_of=1)
    fields = client.realisations(4)
    assert fields.values.shape == (4, 50, 50)
    assert (fields.x_m[0], fields.y_m[-1], fields.resolution_m) == (5.0, 495.0, 10.0)
    assert np.array_equal(client.realisations(4, as_of=fields.revision).values, fields.values)
    heard = {news.topic for news, _ in zip(client.live(timeout_s=PATIENCE_S), range(6), strict=False)}
    assert heard & {"tm/state", "earth/ground/status", "earth/link/status", "tm/event", "tm/sample"}


def test_a_command_passes_its_stages_in_order_with_the_light_time(client: MissionClient) -> None:
    paused = client.command("pause")
    paused.wait("completed", PATIENCE_S)

    def stages() -> dict[str, float]:
        found = [status for status in client.commands() if status.command.command_id == paused.command_id]
        return {report.stage.value: report.at / 1e9 for report in found[-1].stages}

    # The link says on Earth when it radiated: on a busy machine later than the rover's own word comes.
    until(lambda: "radiated" in stages(), "the link's word that the command was radiated")
    at = stages()
    assert [stage for stage in at if stage != "accepted"] == [
        "queued", "released", "radiated", "received", "started", "completed",
    ]  # fmt: skip
    assert 1.282 - 1e-6 <= at["received"] - at["radiated"] <= 1.282 + 0.5 * RATE
    assert client.command("resume").wait("completed", PATIENCE_S).stages[-1].stage.value == "completed"
    with pytest.raises(InvalidInput, match="expected one of pause"):
        client.command("dance")
    with pytest.raises(He3Error, match="expected a target within"):
        client.command("go-to", target_m=(900.0, 1.0))


def test_an_area_of_interest_is_kept_by_the_ground_until_it_is_taken_back(client: MissionClient) -> None:
    areas = client.set_interest("ridge", [(100, 100), (200, 100), (150, 200)], 3.0)
    assert [(area.area_id, area.weight) for area in areas] == [("ridge", 3.0)]
    assert client.set_interest() == areas
    with pytest.raises(He3Error, match="expected corners within"):
        client.set_interest("far", [(100, 100), (900, 100), (150, 200)])
    assert client.set_interest("ridge") == ()


def test_areas_are_added_renamed_and_removed_from_the_command_line_which_prints_what_is_set_then(
    running: tuple[Launcher, Endpoints], client: MissionClient
) -> None:
    def said(*words: str) -> dict[str, Any]:
        done = he3(running[1], "area", *words, "--yes", "--json")
        assert (done.returncode, done.stderr) == (0, "")
        document: dict[str, Any] = json.loads(done.stdout)
        return document

    def names(document: dict[str, Any]) -> list[str]:
        return [each["name"] for each in document["areas"] if each["state"] != "being removed"]

    corners = ("400,400", "420,400", "410,420")
    added = said("add", "crest", *corners, "--interest", "--weight", "3")
    assert (names(added), added["commands"]) == (["crest"], [])
    assert names(said("rename", "crest", "rim")) == ["rim"]
    assert names(said("remove", "rim")) == []
    (sent,) = said("add", "pit", *corners)["commands"]
    assert (sent["command"]["kind"], sent["command"]["area_id"]) == ("set_keep_out", "pit")
    renamed = said("rename", "pit", "hole")
    assert [each["command"]["area_id"] for each in renamed["commands"]] == ["hole", "pit"]
    assert names(renamed) == ["hole"]
    assert names(said("remove", "hole")) == []
    assert {sent["command"]["command_id"]} < {each.command.command_id for each in client.commands()}


def test_the_areas_of_an_earlier_map_are_those_of_when_it_was_last_shown(
    running: tuple[Launcher, Endpoints], client: MissionClient, tmp_path: Path
) -> None:
    def next_revision() -> int:
        shown = client.status().map_revision
        until(lambda: client.history().revisions[-1].revision > shown, "a further map")
        return shown

    corners = [(100, 100), (200, 100), (150, 200)]
    client.set_interest("early", corners, 3.0)
    revision = next_revision()
    client.set_interest("early")
    client.set_interest("late", corners, 2.0)
    try:
        for flags, wanted in ((("--as-of", str(revision)), "early"), ((), "late")):
            done = he3(running[1], "map", "export", str(tmp_path / wanted), *flags, "--quiet", "--json")
            assert (done.returncode, done.stderr) == (0, "")
            areas = json.loads((tmp_path / wanted / "interest_areas.geojson").read_text())["features"]
            assert [each["properties"]["area_id"] for each in areas] == [wanted]
    finally:
        client.set_interest("late")


def test_a_file_of_an_earlier_map_has_that_map(
    running: tuple[Launcher, Endpoints], client: MissionClient, tmp_path: Path
) -> None:
    until(lambda: client.status().samples > 1, "a map of two samples")
    first = client.history().revisions[0]
    done = he3(running[1], "map", "export", str(tmp_path / "map.npz"), "--as-of", str(first.revision), "--json")
    assert json.loads(done.stdout) == {
        "file": str(tmp_path / "map.npz"), "revision": first.revision, "samples": first.samples
    }  # fmt: skip
    with np.load(tmp_path / "map.npz") as written:
        assert written["mean_ppb"].mean() == pytest.approx(client.layer("mean", as_of=first.revision).values.mean())


def he3(endpoints: Endpoints, *words: str) -> subprocess.CompletedProcess[str]:
    return he3_here(*words, "--mission", MISSION, "--earth", endpoints.earth)


def test_a_stack_is_checked_whole_sent_in_order_and_stopped_at_its_first_failure(
    running: tuple[Launcher, Endpoints], client: MissionClient, tmp_path: Path
) -> None:
    endpoints, before = running[1], len(client.commands())
    stack = tmp_path / "hold.stack"
    stack.write_text(
        "pause\nafter completed, at next contact: resume\nkeep-out a 0,0 9,0 0,9\nkeep-out a\nkeep-out a\nsafe\n"
    )
    dry = he3(endpoints, "stack", "run", str(stack), "--dry-run", "--json")
    assert (dry.returncode, len(json.loads(dry.stdout)["lines"]), json.loads(dry.stdout)["sent"]) == (0, 6, [])
    assert he3(endpoints, "stack", "run", "--do", "resume").returncode == 2
    assert len(client.commands()) == before
    done = he3(endpoints, "stack", "run", str(stack), "--yes", "--json")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "line 5 (keep-out a): rejected: there is no keep-out a to remove; 5 of 6 commands" in done.stderr
    sent = json.loads(done.stdout)["sent"]
    assert [each["status"]["stages"][-1]["stage"] for each in sent] == 4 * ["completed"] + ["rejected"]
    assert len(client.commands()) == before + 5


def test_alarms_are_seen_shelved_and_logged_with_the_name_of_who_did_it(
    running: tuple[Launcher, Endpoints], client: MissionClient
) -> None:
    endpoints = running[1]

    def alarms(*flags: str) -> list[dict[str, Any]]:
        done = he3(endpoints, "alarms", *flags, "--json")
        assert (done.returncode, done.stderr) == (0, "")
        return [each for each in json.loads(done.stdout)["alarms"] if each["kind"] == "no_contact"]

    refused = he3(endpoints, "alarms", "acknowledge", "no-contact")
    assert (refused.returncode, "there is no alarm no-contact" in refused.stderr) == (1, True)
    client.set_link(contact=False)
    try:
        (alarm,) = alarms()
        assert (alarm["severity"], alarm["active"], alarm["acknowledged"]) == ("warning", True, False)
        (seen,) = alarms("acknowledge", "no-contact", "--as", "anna")
        assert (seen["acknowledged"], seen["acknowledged_by"]) == (True, "anna")
        assert he3(endpoints, "alarms", "shelve", "no-contact", "--for", "1d", "--as", "ben").returncode == 0
        (alarm,) = alarms()
        assert (alarm["acknowledged_by"], alarm["shelved_by"]) == ("anna", "ben")
    finally:
        client.set_link(contact_as_scheduled=True)
    assert alarms() == []
    client.set_interest("rim", [(100, 100), (200, 100), (150, 200)], 3.0)
    client.set_interest("rim")
    lines = json.loads(he3(endpoints, "log", "--json").stdout)
    found = {(each["kind"], each["text"], each["by"]) for each in lines}
    for expected in (
        ("link", "contact off (black-out)", client.person),
        ("link", "contact as scheduled", client.person),
        ("alarm", "no-contact acknowledged", "anna"),
        ("interest", "area of interest rim removed", client.person),
        ("event", "round 1", ""),
    ):
        assert any(each[0] == expected[0] and expected[1] in each[1] and each[2] == expected[2] for each in found)
    assert he3(endpoints, "log", "--csv", "--kind", "interest").stdout.count("\n") >= 3
    assert [each["known_at"] for each in lines] == sorted(each["known_at"] for each in lines)


def test_every_map_command_prints_text_and_json(running: tuple[Launcher, Endpoints], tmp_path: Path) -> None:
    endpoints = running[1]
    for words in (
        ("map", "box", "mean", "0", "0", "100", "100", "--resolution", "10"),
        ("map", "resource", "100,100", "200,100", "150,200"),
        ("map", "grade-tonnage", "100,100", "200,100", "150,200", "--cutoffs", "7,8", "--png", str(tmp_path / "c.png")),
        ("map", "cross-validation", "--png", str(tmp_path / "check.png")),
        ("map", "realisations", str(tmp_path / "fields.npz"), "--count", "6", "--png", str(tmp_path / "fields.png")),
        ("map", "samples"),
        ("map", "plan"),
        ("map", "history"),
        ("map", "save", "mean", str(tmp_path / "mean.tif")),
        ("map", "show", "mean", "--png", str(tmp_path / "mean.png")),
        ("map", "box", "mean", "0", "0", "100", "100", "--out", str(tmp_path / "box.csv")),
    ):
        for flags in ((), ("--json",)):
            done = he3(endpoints, *words, *flags)
            assert (done.returncode, done.stderr) == (0, ""), words
            assert done.stdout
            if flags:
                json.loads(done.stdout)
    follow = he3(endpoints, "map", "follow", "--seconds", "2", "--json")
    assert json.loads(follow.stdout.splitlines()[0])["samples"] >= 2
    refused = he3(endpoints, "map", "box", "mean", "0", "0", "1000", "100")
    assert refused.returncode != 0
    assert refused.stderr.count("\n") == 1
    assert "expected edges within" in refused.stderr


def test_the_map_is_exported_for_other_tools_as_one_revision(
    running: tuple[Launcher, Endpoints], client: MissionClient, tmp_path: Path
) -> None:
    rasterio = pytest.importorskip("rasterio")
    pystac = pytest.importorskip("pystac")
    done = he3(running[1], "map", "export", str(tmp_path / "maps"), "--threshold", "9", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    assert document["notes"] == []
    item = pystac.Item.from_file(str(tmp_path / "maps" / document["files"][-1]))
    assert item.properties["he3:revision"] == document["revision"]
    assert {layer["kind"] for layer in item.properties["he3:region_layers"]} == {"synthetic", "derived"}
    for name, threshold in (("mean", None), ("std", None), ("exceedance", 9.0)):
        shown = client.layer(name, threshold=threshold, as_of=document["revision"])
        with rasterio.open(tmp_path / "maps" / f"{name}.tif") as raster:
            assert np.array_equal(raster.read(1)[::-1], shown.values), name
    with rasterio.open(tmp_path / "maps" / "simulation_reference.tif") as raster:
        assert raster.tags()["LABEL"] == "simulation only"


def test_the_notebook_runs_top_to_bottom(running: tuple[Launcher, Endpoints], monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    monkeypatch.setenv("HE3_EARTH", running[1].earth)
    monkeypatch.setenv("HE3_MISSION", MISSION)
    notebook = json.loads((ROOT / "examples" / "operator.ipynb").read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": "__main__"}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"operator.ipynb {cell['id']}", "exec"), names)
    assert names["resumed"].stages[-1].stage.value == "completed"
    mpl.pyplot.close("all")


def _answerer_of(ground: int) -> int:
    """Process id of the process that answers for the ground."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
                parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except (OSError, IndexError):
                continue
            if b"services.ground.map.process" in words and parent == ground:
                return int(entry.name)
    return 0


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_a_query_process_that_is_killed_is_replaced_and_the_ground_goes_on(
    running: tuple[Launcher, Endpoints], client: MissionClient
) -> None:
    launcher, _ = running
    before = _answerer_of(launcher.pids["ground"])
    os.kill(before, signal.SIGKILL)
    after = until(lambda: (pid := _answerer_of(launcher.pids["ground"])) not in (0, before) and pid, "another one")
    assert after != before
    point = until(lambda: quietly(lambda: client.point(10.0, 20.0)), "an answer")
    assert point.samples >= 2
    launcher.check()


@pytest.mark.exhaustive
def test_foxglove_gets_a_live_mission_whole_whenever_it_joins(
    running: tuple[Launcher, Endpoints], client: MissionClient
) -> None:
    """A viewer that knows the protocol: it subscribes to all channels and decodes with their schemas alone."""
    pytest.importorskip("foxglove")
    websocket = pytest.importorskip("websocket")
    known = {name: (x, y) for name, x, y in client.samples()[["sample_id", "x_m", "y_m"]]}
    words = ("foxglove", "--port", "0", "--earth", running[1].earth, "--mission", MISSION)
    with start(he3_command(*words), stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        address = process.stderr.readline().split(" at ")[1].split(" ")[0]
        viewer = Viewer(websocket.create_connection(address, subprotocols=["foxglove.sdk.v1"], timeout=PATIENCE_S))
        own = {f"he3/{MISSION}/earth/ground/status", f"he3/{MISSION}/tm/state", f"he3/{MISSION}/earth/map/overview"}
        found = viewer.messages_of({"/map/mean", "/samples", "/samples/markers", "/plan", "/rover", "/tf/rover", *own})
        viewer.close()
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 130
        assert process.stderr.read() == "he3: interrupted\n"
    points = np.frombuffer(found["/samples"][-1].data, dtype="<f4").reshape(-1, 4)
    for name, place in known.items():
        assert np.abs(points[:, :2] - place).max(axis=1).min() < 1e-3, name
    marked = {entity.id for update in found["/samples/markers"] for entity in update.entities}
    assert marked >= {str(name) for name in known}
    assert found["/map/mean"][-1].fields[0].name == "mean_ppb"
    # Where one round has just ended and the next is on its way, the plan shows no way ahead.
    ahead = [line.points for update in found["/plan"] for entity in update.entities for line in entity.lines]
    assert all(0.0 <= point.x <= 500.0 and 0.0 <= point.y <= 500.0 for points in ahead for point in points)
    state = json.loads(found[f"he3/{MISSION}/tm/state"][-1])["body"]
    assert 0 <= state["x_m"] <= 500


class Viewer:
    """A client of Foxglove's WebSocket protocol."""

    def __init__(self, connection: Any) -> None:
        self._connection = connection
        self._channels: dict[int, dict[str, Any]] = {}

    def messages_of(self, wanted: set[str]) -> dict[str, list[Any]]:
        """All messages until each of those topics has one, decoded; fails after a time in which they do not come."""
        found: dict[str, list[Any]] = {}
        until(lambda: self._take(found) and wanted <= set(found), f"messages of {wanted}")
        return found

    def close(self) -> None:
        self._connection.close()

    def _take(self, found: dict[str, list[Any]]) -> bool:
        kind, data = self._connection.recv_data()
        if kind == 1:
            self._subscribe(json.loads(data).get("channels", ()))
        elif data[0] == 1:  # a message: subscription, log time, payload
            channel = self._channels[int.from_bytes(data[1:5], "little")]
            payload = data[13:]
            if channel["encoding"] == "protobuf":
                described = FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
                payload = GetMessages(described.file)[channel["schemaName"]].FromString(payload)
            found.setdefault(channel["topic"], []).append(payload)
        return True

    def _subscribe(self, channels: Iterable[dict[str, Any]]) -> None:
        self._channels |= {channel["id"]: channel for channel in channels}
        wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in channels]
        self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
