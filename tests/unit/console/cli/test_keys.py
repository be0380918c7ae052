"""``he3 keys``: an authority and identities from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from schemas.roles import Role
from services.console.__main__ import main
from services.console.launch.keys import launch_keys, temporary_keys
from services.runtime.trust.identity import load_identity


def test_a_new_folder_of_keys_has_an_identity_for_each_process_and_for_the_launcher(tmp_path, capsys):
    keys = tmp_path / "keys"
    assert main(["keys", "init", str(keys)]) == 0
    found = launch_keys(keys)
    assert set(found.processes) == {"link", "field", "rover", "ground", "recorder"}
    assert {load_identity(path).role.value for path in found.processes.values()} == set(found.processes)
    assert load_identity(found.viewer).role is Role.VIEWER
    assert capsys.readouterr().out.splitlines() == [str(path) for path in (*found.processes.values(), found.viewer)]


def test_every_change_of_the_keys_prints_its_identities_in_the_form_of_the_list(tmp_path, capsys):
    keys = str(tmp_path / "keys")

    def said(*words):
        assert main(["keys", *words, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    assert {row["role"] for row in said("init", keys)} == {
        "link", "field", "rover", "ground", "recorder", "viewer"
    }  # fmt: skip
    (issued,) = said("issue", "operator", "anna", "--in", keys)
    assert (issued["common_name"], issued["state"]) == ("operator.anna", "valid")
    assert load_identity(Path(issued["folder"])).common_name == "operator.anna"
    (renewed,) = said("renew", "operator", "anna", "--in", keys)
    assert renewed["serial"] != issued["serial"]
    (revoked,) = said("revoke", "operator", "anna", "--in", keys)
    assert revoked["state"] == "revoked"
    assert revoked in said("list", "--in", keys)
    files = said("zenoh", keys, "t1", "--out", str(tmp_path / "zenoh"))["files"]
    assert all(Path(each).is_file() for each in files)
    assert len(files) == 2


def test_identities_are_issued_listed_renewed_and_revoked(tmp_path, capsys):
    keys = str(tmp_path / "keys")

    def rows():
        capsys.readouterr()
        assert main(["keys", "list", "--in", keys, "--json"]) == 0
        return {row["common_name"]: row for row in json.loads(capsys.readouterr().out)}

    assert main(["keys", "init", keys]) == 0
    assert main(["keys", "issue", "operator", "anna", "--in", keys, "--days", "1", "--host", "earth.example"]) == 0
    before = rows()["operator.anna"]
    assert before["state"] == "valid"
    assert main(["keys", "renew", "operator", "anna", "--in", keys, "--days", "30"]) == 0
    renewed = rows()["operator.anna"]
    assert renewed["expires"] > before["expires"]
    assert renewed["serial"] != before["serial"]
    assert main(["keys", "revoke", "operator", "anna", "--in", keys]) == 0
    assert rows()["operator.anna"]["state"] == "revoked"
    assert main(["keys", "list", "--in", keys]) == 0
    assert "operator.anna" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["keys", "issue", "pilot", "anna", "--in", "KEYS"], "role: expected one of field, rover,"),
        (["keys", "issue", "operator", "../anna", "--in", "KEYS"], "name: expected at most 32 of"),
        (["keys", "issue", "rover", "two", "--in", "KEYS", "--host", "x"], "--host: expected it for viewer,"),
        (["keys", "issue", "operator", "anna", "--in", "KEYS", "--days", "0"], "expected above 0 up to 36500"),
        (["keys", "list", "--in", "nowhere"], "nowhere: expected a folder of keys"),
        (["keys", "init", "KEYS"], "expected a new folder, got one that has an authority"),
        (["run", "short", "--in-process", "--keys", "KEYS"], "--keys: expected it with separate processes"),
        (["run", "short", "--keys", "nowhere"], "nowhere: expected a folder of keys"),
        (["up", "short", "--set", "network.moon=tcp/0.0.0.0:1"], "tcp/0.0.0.0:1: expected TLS off loopback"),
    ],
)
def test_bad_input_is_one_line_and_changes_nothing(tmp_path, capsys, words, line):
    keys = tmp_path / "keys"
    assert main(["keys", "init", str(keys)]) == 0
    before = {path: path.read_bytes() for path in keys.rglob("*") if path.is_file()}
    capsys.readouterr()
    assert main([str(keys) if word == "KEYS" else word for word in words]) == 2
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1
    assert {path: path.read_bytes() for path in keys.rglob("*") if path.is_file()} == before


def test_a_folder_without_a_process_is_refused_with_the_command_that_mends_it(tmp_path, capsys):
    keys = str(tmp_path / "keys")
    assert main(["keys", "init", keys]) == 0
    assert main(["keys", "revoke", "rover", "main", "--in", keys]) == 0
    assert main(["run", "short", "--lockstep", "--keys", keys]) == 2
    assert "expected one identity of role rover, got none: he3 keys issue rover main" in capsys.readouterr().err


def test_temporary_keys_are_gone_afterwards():
    with temporary_keys() as keys:
        assert load_identity(keys / "identities" / "operator-demo").role is Role.OPERATOR
        launch_keys(keys)
    assert not keys.exists()
