"""The audit log: what was altered, taken out, put in or cut is found; what a killed process left is told apart."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from io import BytesIO

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from he3.errors import InvalidInput
from services.runtime.trust.audit import (
    BEGINNING,
    AuditKind,
    AuditLog,
    audit_line,
    file_lines,
    line_hash,
    rows,
    verify,
)

AT = datetime(2026, 11, 26, tzinfo=UTC)
KEY = Ed25519PrivateKey.from_private_bytes(b"k" * 32)
OTHER = Ed25519PrivateKey.from_private_bytes(b"o" * 32)
KEYS = {
    "ground.main": KEY.public_key(),
    **dict.fromkeys(("ground.main.2", "rover.main", "viewer.eve"), OTHER.public_key()),
}


def written(count=6, signer=None):
    lines, previous = [], BEGINNING
    for number in range(count):
        fields = {"by": "operator.anna", "what": f"pause c-{number}"}
        line = audit_line(number, previous, AuditKind.COMMAND, AT, fields, signer)
        lines.append(line + b"\n")
        previous = line_hash(line)
    return lines


def as_read(lines):
    """The lines as a file gives them: a newline that was put in begins another one."""
    return list(BytesIO(b"".join(lines)))


def test_a_whole_log_has_no_fault_and_its_last_hash_as_head():
    lines = written()
    verdict = verify(lines)
    assert (verdict.fault, verdict.lines, verdict.torn) == (None, 6, ())
    assert verdict.head == line_hash(lines[-1].rstrip())
    assert verify([]).head == BEGINNING


@given(st.data())
def test_one_changed_bit_anywhere_before_the_last_line_is_found_at_its_line(data):
    lines = written()
    at = data.draw(st.integers(0, 3))
    bit = data.draw(st.integers(0, 8 * (len(lines[at]) - 1) - 1))
    altered = bytearray(lines[at])
    altered[bit // 8] ^= 1 << bit % 8
    changed = as_read([*lines[:at], bytes(altered), *lines[at + 1 :]])
    fault = verify(changed).fault
    assert fault is not None
    assert fault.startswith((f"line {at + 1}:", f"line {at + 2}:"))
    if bit // 8 > len(b'{"number":0,"previous":"') + 64:
        assert fault.startswith(f"line {at + 1}:")


@given(st.data())
def test_one_changed_bit_of_any_signed_line_is_found_at_its_line(data):
    lines = written(signer=("ground.main", KEY))
    at = data.draw(st.integers(0, 5))
    bit = data.draw(st.integers(0, 8 * (len(lines[at]) - 1) - 1))
    altered = bytearray(lines[at])
    altered[bit // 8] ^= 1 << bit % 8
    changed = as_read([*lines[:at], bytes(altered), *lines[at + 1 :]])
    fault = verify(changed, KEYS.get).fault
    assert fault is not None
    assert fault.startswith(f"line {at + 1}:")


@pytest.mark.parametrize("at", range(5))
def test_a_line_that_is_taken_out_is_missed(at):
    lines = written()
    assert verify(lines[:at] + lines[at + 1 :]).fault == (
        f"line {at + 1}: 1 missing before it (expected number {at}, got {at + 1})"
    )


def test_a_line_that_is_put_in_twice_is_found():
    lines = written()
    assert verify([*lines[:3], lines[2], *lines[3:]]).fault == "line 4: out of place (expected number 3, got 2)"


def test_a_rest_that_is_written_anew_is_found_by_its_signatures():
    lines = written(signer=("ground.main", KEY))
    forged, previous = lines[:2], line_hash(lines[1].rstrip())
    for number in range(2, 6):
        line = audit_line(number, previous, AuditKind.COMMAND, AT, {"by": "nobody"}, None)
        forged.append(line + b"\n")
        previous = line_hash(line)
    assert verify(forged).fault is None, "the hashes alone cannot show it"
    assert verify(forged, KEYS.get).fault == "line 3: not signed"
    assert verify(written(signer=("ground.other", KEY)), KEYS.get).fault == (
        "line 1: signed by 'ground.other', who is not in the roster"
    )


@pytest.mark.parametrize(
    ("signer", "fault"),
    [
        ("viewer.eve", "signed by viewer.eve: expected a process, as no person writes audit logs"),
        ("rover.main", "signed by rover.main: expected ground.main, who has signed the lines before it"),
        ("ground.main.2", None),
    ],
)
def test_no_other_identity_of_the_mission_can_write_the_rest_of_a_log_anew(signer, fault):
    lines = written(2, signer=("ground.main", KEY))
    line = audit_line(2, line_hash(lines[1].rstrip()), AuditKind.CHANGE, AT, {"by": "x"}, (signer, OTHER))
    verdict = verify([*lines, line + b"\n"], KEYS.get)
    assert verdict.fault == (None if fault is None else f"line 3: {fault}")
    assert verdict.signers == (("ground.main", signer) if fault is None else ("ground.main",))


def test_a_log_that_a_person_has_signed_is_no_process_s():
    assert "expected a process" in (verify(written(signer=("viewer.eve", OTHER)), KEYS.get).fault or "")


def test_a_cut_tail_shows_in_the_head_alone():
    lines = written()
    verdict = verify(lines[:-2])
    assert verdict.fault is None
    assert verdict.head != verify(lines).head


@given(st.data())
def test_a_last_line_that_is_cut_anywhere_is_torn_and_no_fault(data):
    lines = written()
    cut = data.draw(st.integers(1, len(lines[-1]) - 2))
    verdict = verify([*lines[:-1], lines[-1][:cut]])
    assert (verdict.fault, verdict.lines, verdict.torn) == (None, 5, (6,))


@pytest.mark.parametrize("end", [b"rubbish", b'{"number":9,"previ', b'{"number":5,"previous":"0000'])
def test_a_last_line_that_no_writer_began_is_no_torn_one(end):
    assert verify([*written(5), end]).fault == (
        "line 6: altered: it is not the next line of an audit log, nor the beginning of one"
    )


def test_a_cut_line_with_a_newline_is_no_torn_one():
    lines = written()
    assert verify([*lines[:-1], lines[-1][:100] + b"\n"]).fault is not None
    assert verify([*lines[:2], lines[2][:100] + b"\n", *lines[2:]]).fault is not None


# --- the file -----------------------------------------------------------------------------------------------------


def log(path, signer=None):
    return AuditLog(path, lambda: AT, signer)


def test_a_file_is_its_owners_alone_and_continues_where_it_ended(tmp_path):
    path = tmp_path / "audit.jsonl"
    for _ in range(2):
        audit = log(path)
        audit.add(AuditKind.COMMAND, by="operator.anna", what="pause c-1", why=None)
        audit.close()
    assert path.stat().st_mode & 0o777 == 0o600
    verdict = verify(file_lines(path))
    assert (verdict.fault, verdict.lines, verdict.head) == (None, 4, audit.head)
    assert [row["kind"] for row in rows(file_lines(path))] == ["opened", "command", "opened", "command"]


@given(st.data())
def test_a_log_goes_on_after_each_kill_and_its_torn_lines_are_named(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("audit") / "audit.jsonl"
    kills = data.draw(st.integers(1, 3))
    for _ in range(kills):
        audit = log(path)
        audit.add(AuditKind.COMMAND, by="operator.anna", what="pause c-1")
        audit.close()
        content = path.read_bytes()
        path.write_bytes(content[: len(content) - data.draw(st.integers(0, len(content.splitlines()[-1]) - 1))])
    log(path).close()
    assert verify(file_lines(path)).fault is None


def test_a_start_that_is_killed_in_its_first_line_is_torn_as_well(tmp_path):
    path = tmp_path / "audit.jsonl"
    for cut in (40, 60):
        log(path).close()
        path.write_bytes(path.read_bytes()[:-cut])
    log(path).close()
    verdict = verify(file_lines(path))
    assert (verdict.fault, verdict.torn) == (None, (1, 2))


def test_a_log_that_was_tampered_with_is_not_continued(tmp_path):
    path = tmp_path / "audit.jsonl"
    path.write_bytes(b"".join([*written(3), written(5)[4]]))
    with pytest.raises(InvalidInput, match="line 4: 1 missing before it"):
        log(path)


def test_a_log_has_one_writer(tmp_path):
    audit = log(tmp_path / "audit.jsonl")
    with pytest.raises(InvalidInput, match="expected an audit log that no other process writes"):
        log(tmp_path / "audit.jsonl")
    audit.close()


def test_texts_of_others_stay_on_their_line(tmp_path):
    audit = log(tmp_path / "audit.jsonl")
    audit.add(AuditKind.REFUSAL, by="x\n\x1b[2J" + "y" * 50_000)
    audit.close()
    lines = list(file_lines(tmp_path / "audit.jsonl"))
    assert len(lines) == 2
    assert json.loads(lines[1])["by"].startswith("x\\n\\x1b[2Jyyy")
    assert verify(lines).fault is None
