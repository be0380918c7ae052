"""``he3 audit``: the audit log from the command line."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import pytest

from services.console.__main__ import main
from services.runtime.trust.audit import AuditKind, AuditLog
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import subject
from services.runtime.trust.identity import load_identity


@pytest.fixture
def authority(tmp_path):
    return Authority.create(tmp_path / "keys")


@pytest.fixture
def log(tmp_path, authority):
    identity = load_identity(authority.issue(subject("ground", "main")))
    path = tmp_path / "ground.jsonl"
    audit = AuditLog(path, lambda: datetime.now(UTC), (identity.common_name, identity.key))
    audit.add(AuditKind.COMMAND, by="operator.anna", verified=True, what="pause c-1")
    audit.add(AuditKind.REFUSAL, by="mallory", verified=False, what="tc/command", why="expected a signature")
    audit.close()
    return path


def test_a_whole_log_is_verified_with_its_signatures_and_its_head(log, authority, capsys):
    assert main(["audit", "verify", str(log), "--keys", str(authority.folder), "--json"]) == 0
    verdict = json.loads(capsys.readouterr().out)
    assert (verdict["whole"], verdict["lines"], verdict["signed"]) == (True, 3, 3)
    assert main(["audit", "verify", str(log), "--head", verdict["head"][:12]]) == 0
    assert "whole: 3 lines" in capsys.readouterr().out


def test_an_altered_line_and_a_cut_tail_are_refused_in_one_line(log, capsys):
    main(["audit", "verify", str(log), "--json"])
    head = json.loads(capsys.readouterr().out)["head"]
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(lines[0] + lines[1])
    assert main(["audit", "verify", str(log)]) == 0, "the file alone cannot show it"
    assert main(["audit", "verify", str(log), "--head", head]) == 2
    assert "its end is missing, or it has grown" in capsys.readouterr().err
    log.write_bytes(lines[0] + lines[1].replace(b"anna", b"otto") + lines[2])
    assert main(["audit", "verify", str(log)]) == 2
    assert capsys.readouterr().err.strip().endswith("ground.jsonl: line 2 or 3: altered")


def test_the_log_is_shown_with_who_did_what(log, capsys):
    assert main(["audit", "show", str(log)]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert "operator.anna" in shown[1]
    assert shown[1].endswith("pause c-1")
    assert "mallory (unverified)" in shown[2]
    assert main(["audit", "show", str(log), "--json"]) == 0
    assert [row["kind"] for row in json.loads(capsys.readouterr().out)] == ["opened", "command", "refusal"]


def test_a_file_that_cannot_be_read_is_an_error_in_one_line(tmp_path, capsys):
    assert main(["audit", "verify", str(tmp_path / "none")]) == 2
    assert "cannot read" in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"", b"\n", b'{"number":0,"prev'])
def test_a_log_that_was_emptied_is_not_called_whole(content, tmp_path, capsys):
    log = tmp_path / "ground.jsonl"
    log.write_bytes(content)
    assert main(["audit", "verify", str(log)]) == 2
    assert "whole" not in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [("audit", "show"), ("stack", "run")])
def test_a_device_without_end_is_refused_in_one_line(arguments, capsys):
    assert main([*arguments, "/dev/zero"]) == 2
    assert capsys.readouterr().err.startswith("he3: ")
