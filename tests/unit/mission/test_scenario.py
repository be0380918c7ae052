"""Scenario files that are not right: refused in one line that names the file, the key and what was expected."""

from __future__ import annotations

from pathlib import Path

import pytest

from he3.errors import InvalidInput
from services.mission.deployment import find_scenario, shipped_scenarios
from services.mission.scenario import MAX_SCENARIO_BYTES, GroundConfig, InterestRegion, checked_scenario, load_scenario

GOOD = 'name = "mine"\nregion = "t1"\n'

BAD = {
    "empty": ("", "name: field required"),
    "no TOML": ("name: mine", "expected TOML, got a syntax error"),
    "half a line": ("name = ", "expected TOML, got a syntax error"),
    "a key twice": (GOOD + 'name = "other"\n', "expected TOML, got a syntax error"),
    "no region": ('name = "mine"\n', "region: field required"),
    "an unknown key": (GOOD + "colour = 1\n", "colour: extra inputs are not permitted, got 1"),
    "an unknown table": (GOOD + "[sky]\nblue = true\n", "sky: extra inputs are not permitted"),
    "a key in the wrong table": (GOOD + "[rover]\nplanner = 'tour'\n", "rover.planner: extra inputs"),
    "a misspelt key": (GOOD + "[rover]\nspeed_ms = 0.1\n", "rover.speed_ms: extra inputs are not permitted"),
    "a name with capitals": ('name = "Mine"\nregion = "t1"\n', "name: string should match pattern"),
    "a name with a slash": ('name = "a/b"\nregion = "t1"\n', "name: string should match pattern"),
    "a name with a wildcard": ('name = "*"\nregion = "t1"\n', "name: string should match pattern"),
    "a name that is too long": (f'name = "{"a" * 49}"\nregion = "t1"\n', "name: string should match pattern"),
    "a seed as text": (GOOD + 'seed = "1"\n', "seed: input should be a valid integer, got '1'"),
    "a seed below nothing": (GOOD + "seed = -1\n", "seed: input should be greater than or equal to 0, got -1"),
    "a truth value for a number": (GOOD + "seed = true\n", "seed: input should be a valid integer, got True"),
    "no rounds": (GOOD + "rounds = 0\n", "rounds: input should be greater than or equal to 1, got 0"),
    "rounds and a half": (GOOD + "rounds = 1.5\n", "rounds: input should be a valid integer"),
    "too many samples": (GOOD + "samples_per_round = 257\n", "samples_per_round: input should be less than or equal"),
    "a hole through the Moon": (GOOD + "sample_depth_m = 3000.0\n", "sample_depth_m: input should be less than"),
    "NaN": (GOOD + "rate = nan\n", "rate: "),
    "infinity": (GOOD + "[rover]\nspeed_m_s = inf\n", "rover.speed_m_s: "),
    "no speed": (
        GOOD + "[rover]\nspeed_m_s = 0.0\n",
        "rover.speed_m_s: input should be greater than or equal to 0.0001, got 0.0",
    ),
    "a slope beyond all rovers": (GOOD + "[rover]\nslope_limit_deg = 90.0\n", "rover.slope_limit_deg: input should be"),
    "a reserve above the resume": (GOOD + "[rover]\nreserve = 0.6\n", "expected resume_charge above reserve"),
    "an unknown planner": (GOOD + "[ground]\nplanner = 'luck'\n", "ground.planner: expected rrt, rrtstar"),
    "an unknown kernel": (GOOD + "[ground]\nkernel = 'flat'\n", "ground.kernel: expected se, matern12"),
    "a start of one number": (GOOD + "start_m = [1.0]\n", "start_m.1: field required"),
    "a start of three numbers": (GOOD + "start_m = [1.0, 2.0, 3.0]\n", "start_m: "),
    "a day for a time": (GOOD + "start = 2030-01-01\n", "start: "),
    "a time without a zone": (GOOD + "start = 2030-01-01T00:00:00\n", "expected a time with its zone"),
    "a time before the Moon was reached": (
        GOOD + "start = 1950-01-01T00:00:00Z\n",
        "expected a year from 1971 to 2200",
    ),
    "a share above one": (GOOD + "[link.up]\nloss = 1.5\n", "link.up.loss: input should be less than or equal to 1"),
    "light that is early": (GOOD + "[link.down]\none_way_light_time_s = -1.0\n", "link.down.one_way_light_time_s: "),
    "a rate of nothing": (GOOD + "[link.up]\nrate_bit_s = 0.0\n", "link.up.rate_bit_s: input should be greater than"),
    "an unknown edge": (GOOD + "[link]\nat_edge = 'wait'\n", "link.at_edge: input should be 'hold' or 'drop'"),
    "a window that closes first": (
        GOOD + "[[link.windows]]\nopens_s = 9.0\ncloses_s = 3.0\n",
        "expected closes_s after opens_s, got 9.0 and 3.0",
    ),
    "windows that overlap": (
        GOOD + "[link]\nwindows = [{opens_s=0.0, closes_s=9.0}, {opens_s=3.0, closes_s=12.0}]\n",
        "expected windows in order that do not overlap",
    ),
    "windows and a duty cycle": (
        GOOD + "[link]\nwindows=[{opens_s=0.0, closes_s=9.0}]\nduty_cycle={period_s=9.0, contact_s=3.0}\n",
        "expected windows or a duty_cycle, got both",
    ),
    "more contact than time": (
        GOOD + "[link]\nduty_cycle = {period_s = 1.0, contact_s = 2.0}\n",
        "expected contact_s within period_s, got 2.0 of 1.0",
    ),
    "an area with two corners": (GOOD + "[ground]\nkeep_outs_m = [[[0.0, 0.0], [1.0, 1.0]]]\n", "ground.keep_outs_m.0"),
    "an interest beyond all others": (
        GOOD + "[ground]\ninterest = [{polygon_m = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]], weight = 1e300}]\n",
        "ground.interest.0.weight: input should be less than or equal to 1000",
    ),
    "an endpoint that is none": (GOOD + "[network]\nmoon = 'somewhere'\n", "network.moon: string should match pattern"),
}


@pytest.mark.parametrize(("text", "expected"), BAD.values(), ids=BAD.keys())
def test_a_bad_scenario_is_refused_in_one_line_with_file_and_key(tmp_path, text, expected):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(InvalidInput) as refused:
        load_scenario(path)
    line = str(refused.value)
    assert line.startswith(f"{path}: ")
    assert expected in line
    assert "\n" not in line
    assert len(line) < 400 + len(str(path))


@pytest.mark.parametrize("key", ["planner = 'dijkstra'", "hyperparameters = 'guess'"])
def test_one_fault_is_counted_as_one_though_the_defaults_of_other_keys_follow_from_it(tmp_path, key):
    path = tmp_path / "mine.toml"
    path.write_text(GOOD + f"[ground]\n{key}\n")
    with pytest.raises(InvalidInput, match=f"ground.{key.split()[0]}: ") as refused:
        load_scenario(path)
    assert "more)" not in str(refused.value)
    path.write_text(GOOD + f"[ground]\n{key}\npipeline = -1\n")
    with pytest.raises(InvalidInput, match=r"\(and 1 more\)$"):
        load_scenario(path)


def test_a_file_that_is_too_long_is_read_no_further_than_its_limit(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(GOOD + "#" * MAX_SCENARIO_BYTES)
    with pytest.raises(InvalidInput, match=f"expected a scenario of at most {MAX_SCENARIO_BYTES} bytes, got"):
        load_scenario(path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs a device without an end")
def test_a_device_without_an_end_is_refused():
    with pytest.raises(InvalidInput, match=f"expected a scenario of at most {MAX_SCENARIO_BYTES} bytes, got more"):
        load_scenario(Path("/dev/zero"))


def test_a_byte_order_mark_and_carriage_returns_change_nothing(tmp_path):
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    (tmp_path / "plain.toml").write_text(GOOD)
    assert load_scenario(path) == load_scenario(tmp_path / "plain.toml")


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(b'name = "\xff\xfe"\n')
    with pytest.raises(InvalidInput, match="expected UTF-8 text, got other bytes"):
        load_scenario(path)


def test_the_good_one_among_them_loads(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    assert load_scenario(path).name == "mine"


def test_a_region_file_is_found_in_the_working_directory_or_else_beside_the_scenario(tmp_path, monkeypatch):
    folder, elsewhere = tmp_path / "scenarios", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    path = folder / "mine.toml"
    path.write_text(GOOD.replace('"t1"', '"my.npz"'))
    monkeypatch.chdir(elsewhere)
    assert load_scenario(path).region == "my.npz"  # nowhere; who loads the region says so
    (folder / "my.npz").write_bytes(b"")
    assert load_scenario(path).region == str((folder / "my.npz").resolve())
    monkeypatch.chdir(tmp_path)
    assert load_scenario(Path("scenarios/mine.toml")).region == str((folder / "my.npz").resolve())
    monkeypatch.chdir(elsewhere)
    (elsewhere / "my.npz").write_bytes(b"")
    assert load_scenario(path).region == "my.npz"


@pytest.mark.parametrize("name", ["x" * 5000, "a\\u0000b"], ids=["too long", "not text"])
def test_a_region_name_that_no_file_can_have_is_left_to_who_loads_it(tmp_path, name):
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace('"t1"', f'"{name}.npz"'))
    assert load_scenario(path).region.endswith(".npz")


def test_an_unknown_name_is_answered_with_those_that_ship():
    with pytest.raises(InvalidInput) as refused:
        find_scenario("t9")
    assert all(name in str(refused.value) for name in shipped_scenarios())


def test_areas_of_a_scenario_have_ids_that_count_from_one():
    one, two = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)), ((5.0, 5.0), (6.0, 5.0), (6.0, 6.0))
    ground = GroundConfig(keep_outs_m=(one, two), interest=(InterestRegion(polygon_m=two, weight=2.0),))
    assert ground.keep_outs == {"scenario-1": one, "scenario-2": two}
    assert ground.interests == {"scenario-1": ground.interest[0]}


def test_a_rule_over_several_values_says_once_what_came():
    with pytest.raises(InvalidInput) as refused:
        checked_scenario({"name": "s", "region": "t1", "ground": {"cost": "energy", "budget_m": 100.0}}, "s.toml")
    assert str(refused.value).count("got") == 1


def test_a_scenario_that_names_no_kernel_mixes_all_and_one_of_maximum_likelihood_has_the_published_one() -> None:
    assert GroundConfig().kernel == "auto"
    assert GroundConfig(hyperparameters="ml").kernel == "matern52"
    assert GroundConfig(hyperparameters="ml", kernel="auto").kernel == "auto"
    assert GroundConfig(kernel="se").kernel == "se"
    plain = checked_scenario({"name": "plain", "region": "t1"}, "plain").changed(top={"seed": 2})
    assert plain.ground.kernel == "auto"
    assert plain.changed(ground={"hyperparameters": "ml"}).ground.kernel == "matern52"
