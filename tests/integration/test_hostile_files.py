"""Files that another user may have written: no code of theirs runs, nothing of ours is lost, and memory is bounded."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from services.mission.deployment import find_scenario
from services.mission.scenario import load_scenario
from services.recorder.recovery import MAX_RECORD_BYTES
from services.recorder.writer import MISSION_RECORD
from services.runtime.child import python_command
from services.runtime.journal import CRC_BYTES, FORMAT, PROFILE, _checksum, identity_of
from tests.processes import he3_here, run


class Touches:
    """Unpickled, it makes a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return Path.touch, (self._path,)


@pytest.mark.parametrize("channel", ["computed", "state", "message"])
def test_a_journal_of_another_s_making_runs_no_code(channel: str, tmp_path: Path) -> None:
    """Whole, with right checksums, for this very mission: all that its author has to know."""
    ran, journal = tmp_path / "ran", tmp_path / "journal"
    journal.mkdir()
    evil = pickle.dumps(Touches(ran))
    pickle.loads(evil)
    ran.unlink()  # it would run
    identity = {**identity_of(load_scenario(find_scenario("short"))), "node": "rover"}
    with (journal / "rover-0001.mcap").open("wb") as stream:
        writer = Writer(stream, use_chunking=False, compression=CompressionType.NONE)
        writer.start(profile=PROFILE)
        writer.add_metadata(PROFILE, {**identity, "format": FORMAT})
        number = writer.register_channel(topic=channel, message_encoding="pickle", schema_id=0)
        data = _checksum(0, 1, channel, evil) + evil
        assert len(data) == CRC_BYTES + len(evil)
        writer.add_message(number, log_time=1, publish_time=1, data=data)
    (journal / "rover.checkpoint").write_bytes(evil)
    done = run(python_command("services.rover", "short", "--journal", str(journal)))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines()[-1].startswith("he3 rover: ")
    assert "Traceback" not in done.stderr
    assert not ran.exists()


def test_a_scenario_of_another_s_making_runs_no_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = tmp_path / "ran"
    (tmp_path / "evil.py").write_text(f"open({str(ran)!r}, 'w').close()\ndef plan(request): return []\n")
    scenario = tmp_path / "theirs.toml"
    scenario.write_text('name = "theirs"\nregion = "t1"\n[ground]\nplanner = "evil:plan"\n')
    monkeypatch.chdir(tmp_path)
    for words in (("run", "--in-process"), ("up",)):
        done = he3_here(words[0], str(scenario), *words[1:])
        assert done.returncode == 2
        assert "expected --allow-plugin" in done.stderr
    assert not ran.exists()


def test_an_output_in_place_of_which_another_has_put_a_link_leaves_what_the_link_names(tmp_path: Path) -> None:
    out, theirs = tmp_path / "out", tmp_path / "theirs"
    out.mkdir()
    theirs.write_text("precious")
    (out / ".lock").symlink_to(theirs)
    done = he3_here("run", "short", "--in-process", "--out", str(out))
    # The same command meets the link again, so it is bad input.
    assert (done.returncode, ".lock" in done.stderr) == (2, True)
    assert theirs.read_text() == "precious"


def bomb(path: Path, size: int) -> None:
    """A recording with a chunk that unpacks to so many zeros."""
    compressor = zstandard.ZstdCompressor().compressobj(size=size)
    step = bytes(2**24)
    packed = b"".join(compressor.compress(step) for _ in range(size // len(step))) + compressor.flush()
    assert len(packed) < size / 1000
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start()
        writer.add_metadata(MISSION_RECORD, {"mission": "short"})
        stream.write(_chunk(size, packed))
        writer.finish()


def _chunk(size: int, packed: bytes) -> bytes:
    """An MCAP chunk: its frame, times, size, no checksum, compression, and the packed content."""
    body = bytes(16) + size.to_bytes(8, "little") + bytes(4) + b"\x04\x00\x00\x00zstd"
    body += len(packed).to_bytes(8, "little") + packed
    return b"\x06" + len(body).to_bytes(8, "little") + body


def test_a_recording_that_unpacks_to_gigabytes_takes_no_memory(tmp_path: Path) -> None:
    bomb(tmp_path / "bomb.mcap", 2**30)
    limit = f"import resource, sys; resource.setrlimit(resource.RLIMIT_AS, ({8 * MAX_RECORD_BYTES + 2**29},) * 2)"
    words = ["replay", str(tmp_path / "bomb.mcap")]
    done = run([sys.executable, "-P", "-c", f"{limit}; from services.console.__main__ import main; main({words!r})"])
    assert "MemoryError" not in done.stderr
    assert "a damaged chunk" in done.stdout + done.stderr
