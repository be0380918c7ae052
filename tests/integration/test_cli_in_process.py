"""A mission by the command line, all in one process: complete, repeatable, everything written."""

from __future__ import annotations

import base64
import json
import math
import os
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from schemas.codec import encode
from schemas.ground import InterestArea, InterestList
from schemas.report import MissionReport
from schemas.topics import INTERESTS, MAP_OVERVIEW, STATE
from services.console.__main__ import main
from services.recorder.foxglove.derivation import CHANNELS, STEP_PPB
from services.recorder.reader import Recorded, Recording
from services.recorder.writer import RecordingWriter
from tests.processes import he3_here, run

MISSION = ["run", "short", "--in-process", "--set", "rounds=2", "--set", "samples_per_round=2", "--quiet"]
NO_TIME = ["--set", "ground.budget_h=0.01"]
NO_CONTACT = ["--set", 'link.windows=[{"opens_s": 0, "closes_s": 1800}]', "--set", "ground.patience_h=5"]
NOT_REPEATABLE = {"wall_time_s", "host"}


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("first") / "made" / "here"
    assert main([*MISSION, "--out", str(out)]) == 0
    return out


def report(folder: Path) -> MissionReport:
    return MissionReport.model_validate_json((folder / "report.json").read_bytes())


def test_the_mission_ends_with_every_sample_in_the_map(first: Path) -> None:
    made = report(first)
    assert made.completed
    assert (made.rounds, made.samples, len(made.sample_table), len(made.rmse_history)) == (2, 4, 4, 2)
    assert made.driver == "in-process"
    assert made.rmse_ppb == made.rmse_history[-1].rmse_ppb
    assert 0.5 < made.rmse_ppb < 2.0
    assert made.path_length_m > 100
    assert made.mission_time_s > made.path_length_m / 0.1
    assert made.messages.lost == 0
    under_way = made.messages.up.in_flight + made.messages.down.in_flight
    assert made.messages.sent == made.messages.delivered + under_way > 10
    assert "SYNTHETIC" in made.region_note


def test_report_and_recording_name_where_each_layer_of_the_region_comes_from(first: Path) -> None:
    kinds = {layer.layer: layer.kind for layer in report(first).region_layers}
    assert kinds["iron_wt"] == kinds["elevation_m"] == "synthetic"
    assert kinds["he3_ppb"] == "derived"
    with (first / "mission.mcap").open("rb") as stream:
        records = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    assert "SYNTHETIC" in records["region"]["region"]
    assert records["region"]["iron_wt"].startswith("iron_wt synthetic: drawn by scripts/make_standin_regions.py")


def test_everything_that_is_promised_is_written(first: Path) -> None:
    assert {path.name for path in first.iterdir()} == {"report.json", "map.png", "rmse.png", "mission.mcap"}
    assert all(path.stat().st_size > 5_000 for path in first.iterdir() if path.name != "report.json")


def test_the_recording_holds_every_sample_once_and_the_ground_s_last_word(first: Path) -> None:
    recording = Recording(first / "mission.mcap")
    messages = list(recording.messages())
    assert recording.whole
    samples = [m.body.sample_id for m in messages if m.topic.name == "tm/sample"]
    assert sorted(set(samples)) == sorted(row.sample_id for row in report(first).sample_table)
    last = [m.body for m in messages if m.topic.name == "earth/ground/status"][-1]
    assert last.phase.value == "completed"
    light_time_ns = 1_282_000_000
    delays = {m.received_at - m.header.made_at for m in messages if m.topic.name == "tm/sample"}
    assert delays == {light_time_ns}


def test_the_same_seed_gives_the_same_report_recording_and_pictures(first: Path, tmp_path: Path) -> None:
    assert main([*MISSION, "--out", str(tmp_path)]) == 0
    one, two = (json.loads((folder / "report.json").read_text()) for folder in (first, tmp_path))
    assert {key for key in one if one[key] != two[key]} <= NOT_REPEATABLE
    for name in ("mission.mcap", "map.png", "rmse.png"):
        assert (first / name).read_bytes() == (tmp_path / name).read_bytes()


def test_another_seed_gives_another_mission_and_nothing_is_written_that_was_not_asked_for(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*MISSION, "--seed", "2", "--json"]) == 0
    said = capsys.readouterr()
    other = MissionReport.model_validate_json(said.out)
    assert said.err == ""
    assert other.seed == 2
    assert other.path_m != report(first).path_m
    assert list(tmp_path.iterdir()) == []


def test_progress_on_no_terminal_is_a_line_a_round(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*MISSION[:-1]]) == 0
    said = capsys.readouterr()
    assert "round 2/2" in said.err
    assert "RMSE" in said.out


def test_a_recording_replays_on_the_command_line(first: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(first / "mission.mcap"), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["complete"]
    assert summary["samples"] == 4
    assert summary["last_status"]["phase"] == "completed"
    assert main(["replay", str(first / "mission.mcap"), "--topic", "tm/sample"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {line["body"]["sample_id"] for line in lines} == {row.sample_id for row in report(first).sample_table}


def test_a_reader_that_closes_its_pipe_early_is_no_failure(first: Path) -> None:
    replay = [sys.executable, "-m", "services.console", "replay", str(first / "mission.mcap")]
    for words in (["--topic", "tm/state"], ["--topic", "tm/sample"], ["--json"]):
        reading, writing = os.pipe()
        os.close(reading)
        with open(writing, "wb") as closed_pipe:  # noqa: PTH123 - a descriptor, not a path
            done = run([*replay, *words], stdout=closed_pipe)
        assert (done.returncode, done.stderr) == (0, "")


def test_the_recording_of_a_mission_that_was_ended_says_that_it_was_not_over(
    first: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = tmp_path / "ended.mcap"
    with ended.open("wb") as stream, RecordingWriter(stream, "short") as writer:
        for message in Recording(first / "mission.mcap").messages():
            if message.topic.name == "earth/ground/status" and message.body.phase.value == "completed":
                break
            writer.write(
                message.topic, message.payload, message.received_at, message.header.made_at, message.header.sequence
            )
    assert main(["replay", str(ended)]) == 0
    assert "state      complete file; the mission was not over" in capsys.readouterr().out.splitlines()
    assert main(["replay", str(first / "mission.mcap")]) == 0
    assert "state      complete" in capsys.readouterr().out.splitlines()


def test_a_region_that_was_built_as_a_file_gives_the_mission_of_its_name(
    first: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "t1.npz"
    assert main(["region", "build", "t1", "--out", str(file), "--json"]) == 0
    written = json.loads(capsys.readouterr().out)
    assert (written["written"], written["rows"], written["field_seed"] is None) == (str(file), 500, False)
    assert main([*MISSION, "--set", f"region={file}", "--report", str(tmp_path / "r.json")]) == 0
    again = MissionReport.model_validate_json((tmp_path / "r.json").read_bytes())
    assert again.path_m == report(first).path_m
    assert again.rmse_ppb == pytest.approx(report(first).rmse_ppb, abs=1e-9)


def test_a_mission_that_takes_no_sample_says_so_and_why_and_is_a_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*MISSION, *NO_TIME, "--out", str(tmp_path)]) == 1
    said = capsys.readouterr()
    made = report(tmp_path)
    assert (made.samples, made.samples_wanted) == (0, 4)
    assert f"ended early:  {made.detail}" in said.out.splitlines()
    assert "samples       0 of 4 in 0 rounds" in said.out.splitlines()
    assert said.err == f"he3: the mission took no sample: {made.detail}\n"
    assert made.detail == "0 of 4 samples are in the map; the budget of 0.01 h is spent or promised"


def test_a_mission_whose_contact_ends_has_its_report_and_is_a_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*MISSION, *NO_CONTACT, "--out", str(tmp_path)]) == 1
    said = capsys.readouterr()
    made = report(tmp_path)
    assert not made.completed
    assert "the last contact window closed 1800 s after the mission began" in made.detail
    assert f"ended         NOT COMPLETED: {made.detail}" in said.out.splitlines()
    assert said.err == f"he3: the mission failed {made.mission_time_s:.0f} s after its beginning: {made.detail}\n"


def test_a_reader_that_knows_protobuf_alone_finds_map_samples_path_and_times(first: Path) -> None:
    """The schemas are in the file: nothing of this project, and nothing of Foxglove's, decodes it."""
    ours: dict[str, list[Recorded]] = {}
    for message in Recording(first / "mission.mcap").messages():
        ours.setdefault(message.topic.name, []).append(message)
    found: dict[str, list[tuple[int, int, Any]]] = {}
    with (first / "mission.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages(topics=list(CHANNELS)):
            assert schema is not None
            assert schema.name == decoded.DESCRIPTOR.full_name == f"foxglove.{CHANNELS[channel.topic]}"
            found.setdefault(channel.topic, []).append((message.log_time, message.publish_time, decoded))
    assert set(found) == set(CHANNELS)

    overviews = ours["earth/map/overview"]
    assert len(found["/map/mean"]) == len(overviews)
    for (log, publish, grid), overview in zip(found["/map/mean"], overviews, strict=True):
        assert (log, publish) == (overview.received_at, overview.header.made_at)
        assert grid.cell_size.x == overview.body.step * overview.body.resolution_m
        mean = np.frombuffer(base64.b64decode(overview.body.values.mean_base64), dtype="<f4")
        assert np.abs(np.frombuffer(grid.data, dtype="<f4") - mean).max() <= STEP_PPB / 2

    made = report(first)
    places = sorted((each.x_m, each.y_m, each.helium3_ppb) for each in made.sample_table)
    points = np.frombuffer(found["/samples"][-1][2].data, dtype="<f4").reshape(-1, 4)
    assert np.array(sorted(points[:, [0, 1, 3]].tolist())) == pytest.approx(np.array(places), abs=1e-3)

    turns = [(log, publish, each.translation.x, each.translation.y) for log, publish, each in found["/tf/rover"]]
    states = [(each.received_at, each.header.made_at, each.body.x_m, each.body.y_m) for each in ours["tm/state"]]
    assert turns == states
    path = [(point.x, point.y) for point in found["/rover/path"][-1][2].entities[0].lines[0].points]
    path += [(point.x, point.y) for point in found["/rover"][-1][2].entities[0].lines[0].points]
    length = sum(math.dist(a, b) for a, b in pairwise(path))
    assert length == pytest.approx(made.path_length_m, rel=0.05)  # corners between two reports are cut
    for x, y, _ in places:
        detours = [math.dist(a, (x, y)) + math.dist((x, y), b) - math.dist(a, b) for a, b in pairwise(path)]
        assert min(detours) < 1e-4
    fixes = np.array([(fix.latitude, fix.longitude) for _, _, fix in found["/rover/position"]])
    assert np.abs(fixes - (20.19, 30.77)).max() < 0.02  # Taurus-Littrow


def test_rerun_finds_grid_path_samples_and_rover(first: Path) -> None:
    chunk = pytest.importorskip("rerun.chunk")
    columns: dict[str, Any] = {}
    for each in chunk.McapReader(first / "mission.mcap").stream():
        batch = each.to_record_batch()
        columns |= {f"{each.entity_path} {name}": batch.column(name) for name in batch.schema.names}
    made = report(first)
    points = columns["/samples Points3D:positions"][-1].as_py()
    places = [[each.x_m, each.y_m] for each in made.sample_table]
    assert np.array(sorted(p[:2] for p in points)) == pytest.approx(np.array(sorted(places)), abs=1e-3)
    (last,) = columns["/tf/rover Transform3D:translation"][-1].as_py()
    states = [each for each in Recording(first / "mission.mcap").messages() if each.topic is STATE]
    assert last[:2] == pytest.approx([states[-1].body.x_m, states[-1].body.y_m], abs=1e-3)
    (grid,) = columns["/map/mean foxglove.Grid:message"][-1].as_py()
    assert len(grid["data"]) == 4 * grid["column_count"] ** 2
    (scene,) = columns["/rover/path foxglove.SceneUpdate:message"][-1].as_py()
    assert len(scene["entities"][0]["lines"][0]["points"]) > 1
    assert {name.split(" ")[1] for name in columns} >= {"GeoPoints:positions", "TextLog:text", "EncodedImage:blob"}


def test_areas_of_interest_are_exported_from_a_recording_as_they_were_in_force(first: Path, tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    recording = Recording(first / "mission.mcap")
    messages = list(recording.messages())
    revisions = [each for each in messages if each.topic is MAP_OVERVIEW]
    third = next(each for each in revisions if each.body.revision == 3)
    corners = ((10.0, 10.0), (60.0, 10.0), (60.0, 60.0))
    ridge = InterestList(areas=(InterestArea(area_id="ridge", polygon_m=corners, weight=3.0),))
    changed = tmp_path / "changed.mcap"
    with changed.open("wb") as stream, RecordingWriter(stream, "short", about=recording.about) as writer:
        for message in messages:
            writer.write(message.topic, message.payload, message.received_at, message.header.made_at, 0)
            if message is third:
                payload = encode(third.header, ridge)
                writer.write(INTERESTS, payload, third.received_at, third.header.made_at, 0)

    def exported(*as_of: str) -> list[str]:
        folder = tmp_path / "-".join(("maps", *as_of))
        done = he3_here("map", "export", str(folder), "--recording", str(changed), "--quiet", *as_of)
        assert done.returncode == 0, done.stderr
        areas = json.loads((folder / "interest_areas.geojson").read_text())["features"]
        return [area["properties"]["area_id"] for area in areas]

    assert exported() == ["ridge"]
    assert exported("--as-of", "3") == ["ridge"]
    assert exported("--as-of", "2") == []


def test_the_map_of_a_recording_is_exported_without_a_mission(first: Path, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    recording = str(first / "mission.mcap")
    done = he3_here("map", "export", str(tmp_path / "maps"), "--recording", recording, "--quiet", "--json")
    assert done.returncode == 0, done.stderr
    written, made = json.loads(done.stdout), report(first)
    assert written["samples"] == made.samples
    assert not [note for note in written["notes"] if "differs" in note]
    with rasterio.open(tmp_path / "maps" / "simulation_error.tif") as raster:
        error = raster.read(1).astype(float)
    assert math.sqrt((error**2).mean()) == pytest.approx(made.rmse_ppb, abs=1e-6)
    earlier = he3_here(
        "map", "export", str(tmp_path / "maps"), "--recording", recording, "--as-of", "1", "--json", "-q"
    )
    assert (json.loads(earlier.stdout)["revision"], json.loads(earlier.stdout)["samples"]) == (1, 0)
    for words, expected in (
        (("--as-of", "2020-01-01T00:00:00Z"), "expected a mission time from 2030-01-01"),
        (("--region", "t2"), "t2: expected the mission's region, got another region"),
        (("--mission", "short"), "--recording and --mission or --earth: expected one of them, got both"),
    ):
        refused = he3_here("map", "export", str(tmp_path / "other"), "--recording", recording, *words)
        assert refused.returncode == 2
        assert expected in refused.stderr
        assert len(refused.stderr.splitlines()) == 1
    assert not (tmp_path / "other").exists()
