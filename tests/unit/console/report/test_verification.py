"""`he3 replay --verify`: the belief rebuilt from a recording's samples is the map that the ground had."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.faults import World
from he3.errors import He3Error, InvalidInput
from schemas.codec import encode
from schemas.topics import MAP_OVERVIEW, SAMPLE
from services.console.__main__ import main
from services.console.report.recorded_map import recorded_map
from services.console.report.verification import TOLERANCE_PPB, verify
from services.recorder.reader import Recording
from services.recorder.writer import RecordingWriter
from services.runtime.scheduler import InlineExecutor
from tests.unit.console.flown import SEED, Flown


@pytest.fixture
def flown(flown_with_faults: Flown) -> Path:
    """The recording of a mission that was flown with killed processes and a link that lost, doubled and damaged."""
    return flown_with_faults.path


def test_the_rebuilt_belief_of_a_mission_flown_with_faults_is_the_recorded_map_at_every_revision(flown: Path) -> None:
    result = verify(flown)
    assert result.samples == World(SEED, InlineExecutor()).scenario.samples
    assert result.revisions > result.samples
    assert result.values == result.revisions * 60 * 60
    assert result.largest_ppb <= TOLERANCE_PPB
    assert result.identical == result.revisions
    assert result.after_loss == 0


def test_a_map_is_not_laid_over_a_region_with_another_grid(flown: Path) -> None:
    """The scenario names a region, and the mission was flown on a part of it."""
    with pytest.raises(InvalidInput, match="t1: expected the mission's region, got another region"):
        recorded_map(flown, threshold_ppb=8.0)


@pytest.mark.exhaustive
def test_a_mission_whose_mean_is_uncertain_is_rebuilt_with_that_uncertainty(tmp_path: Path) -> None:
    words = ["run", "short", "--in-process", "--quiet", "--set", "ground.hyperparameters=bayes", "--out", str(tmp_path)]
    assert main(words) == 0
    result = verify(tmp_path / "mission.mcap")
    assert result.identical == result.revisions > result.samples


def test_what_is_whole_of_a_torn_recording_is_compared_and_the_rest_is_not_passed_over(
    flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(flown.read_bytes()[: flown.stat().st_size // 2])
    result = verify(torn)
    assert 0 < result.revisions < verify(flown).revisions
    assert result.equal
    assert result.problems
    assert main(["replay", "--verify", str(torn)]) == 1
    assert "the file ends early" in capsys.readouterr().err


def test_lost_overviews_do_not_hinder_it(flown: Path, tmp_path: Path) -> None:
    thinned = tmp_path / "thinned.mcap"
    seen = 0
    with thinned.open("wb") as stream, RecordingWriter(stream, "faults") as writer:
        for message in Recording(flown).messages():
            if message.topic is MAP_OVERVIEW:
                seen += 1
                if seen in (3, 4):
                    continue
            writer.write(message.topic, message.payload, message.received_at, message.header.made_at, 0)
    result = verify(thinned)
    assert result.revisions == seen - 2
    assert result.equal
    assert 0 < result.after_loss < result.revisions


@pytest.mark.parametrize("change_ppb", [1e-4, 0.5])
def test_a_sample_whose_value_was_changed_shows_as_a_difference(
    flown: Path, tmp_path: Path, change_ppb: float, capsys: pytest.CaptureFixture[str]
) -> None:
    changed = tmp_path / "changed.mcap"
    victim = next(message.body.sample_id for message in Recording(flown).messages() if message.topic is SAMPLE)
    with changed.open("wb") as stream, RecordingWriter(stream, "faults") as writer:
        for message in Recording(flown).messages():
            body = message.body
            if message.topic is SAMPLE and body.sample_id == victim:
                body = body.model_copy(update={"helium3_ppb": body.helium3_ppb + change_ppb})
            payload = encode(message.header, body)
            writer.write(message.topic, payload, message.received_at, message.header.made_at, 0)
    assert main(["replay", "--verify", str(changed), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert not document["equal"]
    assert document["largest_mean_ppb"] > TOLERANCE_PPB
    assert document["identical"] < document["revisions"]


def test_a_sample_that_was_not_recorded_is_named(flown: Path, tmp_path: Path) -> None:
    lacking = tmp_path / "lacking.mcap"
    victim = next(message.body.sample_id for message in Recording(flown).messages() if message.topic is SAMPLE)
    with lacking.open("wb") as stream, RecordingWriter(stream, "faults") as writer:
        for message in Recording(flown).messages():
            if message.topic is not SAMPLE or message.body.sample_id != victim:
                writer.write(message.topic, message.payload, message.received_at, message.header.made_at, 0)
    with pytest.raises(
        He3Error, match=rf"revision \d+ of the map cannot be rebuilt: sample {victim}: expected its report"
    ):
        verify(lacking)


def test_a_recording_without_a_map_is_refused_in_one_line(tmp_path: Path) -> None:
    empty = tmp_path / "empty.mcap"
    with empty.open("wb") as stream:
        RecordingWriter(stream, "m").close()
    with pytest.raises(InvalidInput, match="expected a recording with overviews of the map"):
        verify(empty)
