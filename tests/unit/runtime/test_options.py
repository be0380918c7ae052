"""The command line of a service, and settings that change a scenario."""

from __future__ import annotations

from pathlib import Path

import pytest

from he3.errors import InvalidInput
from he3.kernels import AUTO
from services.console.launch.scenarios import choose
from services.mission.scenario import PUBLISHED_KERNEL, Scenario
from services.runtime.node import Level
from services.runtime.options import parse_options, parse_setting, with_settings


def parse(*arguments: str):
    return parse_options("rover", ["short", *arguments])


def test_a_scenario_alone_is_enough():
    options = parse()
    assert options.scenario.name == "short"
    assert (options.level, options.log_json, options.lockstep) == (Level.INFO, False, False)
    assert (options.out, options.journal, options.events, options.stop_when) == (None, None, None, None)
    assert options.wait_for == ()


def test_every_flag_reaches_its_place():
    options = parse(
        *["--seed", "7", "--rate", "20", "--moon", "tcp/127.0.0.1:1", "--earth", "tcp/127.0.0.1:2"],
        *["--set", "ground.pipeline=2", "--set", "link.up.loss=0.25", "--set", 'ground.planner="tour"'],
        *["--set", "ground.kernel=se", "--log-level", "warning", "--log-json", "--wait-for", "rover,ground"],
        *["--out", "a.mcap", "--journal", "folder", "--events", "b.log"],
    )
    scenario = options.scenario
    assert (scenario.seed, scenario.rate) == (7, 20.0)
    assert (scenario.network.moon, scenario.network.earth) == ("tcp/127.0.0.1:1", "tcp/127.0.0.1:2")
    assert (scenario.ground.pipeline, scenario.ground.planner, scenario.ground.kernel) == (2, "tour", "se")
    assert scenario.link.up.loss == 0.25
    assert scenario.link.down.loss == 0.0
    assert (options.level, options.log_json, options.wait_for) == (Level.WARNING, True, ("rover", "ground"))
    assert (options.out, options.journal, options.events) == (Path("a.mcap"), Path("folder"), Path("b.log"))


BAD = {
    "no scenario": ([], "required: SCENARIO"),
    "two scenarios": (["short", "short"], "unrecognized arguments: short"),
    "an unknown flag": (["short", "--colour", "red"], "unrecognized arguments: --colour red"),
    "an unknown scenario": (["shortt"], "shortt: expected a scenario file or one of"),
    "a missing file": (["./none.toml"], "none.toml: cannot read the scenario: No such file"),
    "a folder": (["."], "cannot read the scenario: Is a directory"),
    "a seed that is a word": (["short", "--seed", "one"], "--seed: invalid int value: 'one'"),
    "a seed that is a fraction": (["short", "--seed", "1.5"], "--seed: invalid int value: '1.5'"),
    "a seed below nothing": (["short", "--seed", "-1"], "seed: input should be greater than or equal to 0, got -1"),
    "a seed without end": (["short", "--seed", str(2**63)], "seed: input should be less than"),
    "a seed that is missing": (["short", "--seed"], "--seed: expected one argument"),
    "no rate": (["short", "--rate", "0"], "rate: input should be greater than 0, got 0"),
    "a rate backwards": (["short", "--rate", "-2"], "rate: input should be greater than 0, got -2"),
    "a rate that is no number": (["short", "--rate", "nan"], "rate: "),
    "a rate without bound": (["short", "--rate", "inf"], "rate: "),
    "a rate beyond all clocks": (["short", "--rate", "1e9"], "rate: input should be less than or equal to 100000"),
    "an endpoint that is none": (["short", "--moon", "here"], "network.moon: "),
    "an endpoint of an unknown kind": (["short", "--earth", "udp/127.0.0.1:1"], "network.earth: "),
    "a setting without a value": (["short", "--set", "ground.pipeline"], "expected KEY=VALUE"),
    "a setting without a key": (["short", "--set", "=3"], "expected KEY=VALUE"),
    "a setting of nothing": (["short", "--set", "ground.colour=3"], "got 'ground.colour', which it does not have"),
    "a setting in nothing": (["short", "--set", "sky.colour=3"], "got 'sky.colour', which it does not have"),
    "a setting below a number": (["short", "--set", "ground.pipeline.x=3"], "got 'ground.pipeline.x'"),
    "a setting of another type": (["short", "--set", "ground.pipeline=many"], "ground.pipeline: "),
    "a setting out of range": (["short", "--set", "link.up.loss=1.5"], "link.up.loss: "),
    "a setting that is no number": (["short", "--set", "link.up.loss=NaN"], "link.up.loss: "),
    "a level that is none": (["short", "--log-level", "loud"], "--log-level: invalid choice: 'loud'"),
    "a flag that takes nothing": (["short", "--log-json=yes"], "--log-json: ignored explicit argument 'yes'"),
}


@pytest.mark.parametrize(("arguments", "expected"), BAD.values(), ids=BAD.keys())
def test_bad_flags_are_refused_in_one_line(arguments, expected):
    with pytest.raises(InvalidInput) as refused:
        parse_options("rover", arguments)
    line = str(refused.value)
    assert expected in line
    assert "\n" not in line


def test_help_names_every_flag_and_shows_an_example(capsys):
    with pytest.raises(SystemExit) as ended:
        parse_options("rover", ["--help"])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    for flag in ("--seed", "--rate", "--moon", "--earth", "--set", "--journal", "--out", "--lockstep", "--events"):
        assert flag in shown
    assert "python -m services.rover t1" in shown


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("seed=3", ("top", "seed", 3)),
        ("ground.planner=tour", ("ground", "planner", "tour")),
        ('ground.planner="tour"', ("ground", "planner", "tour")),
        ("link.up.loss=0.3", ("link", "up.loss", 0.3)),
        ("start_m=[1.0, 2.0]", ("top", "start_m", [1.0, 2.0])),
        ("ground.budget_m=null", ("ground", "budget_m", None)),
        ("description=a = b", ("top", "description", "a = b")),
    ],
)
def test_a_setting_is_read_as_json_where_it_is_json_and_as_text_elsewhere(text, expected):
    assert parse_setting(text) == expected


def test_settings_change_what_they_name_and_nothing_else():
    scenario = parse().scenario
    changed = with_settings(scenario, [parse_setting("ground.pipeline=3")])
    assert changed.ground.pipeline == 3
    assert changed.changed(ground={"pipeline": scenario.ground.pipeline}) == scenario
    assert with_settings(scenario, []) == scenario


def test_a_kernel_that_is_not_named_follows_the_hyperparameters_that_are_set() -> None:
    """`ml` is for the published figures, which are of another kernel than the default."""
    unnamed = Scenario(name="unnamed", region="t1")
    assert unnamed.ground.kernel == AUTO
    published = with_settings(unnamed, [parse_setting("ground.hyperparameters=ml"), parse_setting("seed=7")])
    assert published.ground.kernel == PUBLISHED_KERNEL
    assert with_settings(published, [parse_setting("ground.hyperparameters=bayes")]).ground.kernel == AUTO
    both = [parse_setting("ground.hyperparameters=ml"), parse_setting("ground.kernel=auto")]
    assert with_settings(unnamed, both).ground.kernel == AUTO
    whole = with_settings(unnamed, [parse_setting('ground={"hyperparameters": "ml", "planner": "tour"}')])
    assert whole.ground.kernel == PUBLISHED_KERNEL
    assert unnamed.changed(ground={"hyperparameters": "ml", "kernel": "auto"}).ground.kernel == AUTO


@pytest.fixture
def with_plugin(tmp_path: Path) -> Path:
    """A scenario file that names a plug-in planner, which may be another user's."""
    path = tmp_path / "theirs.toml"
    path.write_text('name = "theirs"\nregion = "t1"\n[ground]\nplanner = "evil:plan"\n')
    return path


def test_a_plug_in_planner_of_a_scenario_s_file_needs_the_user_s_leave(with_plugin: Path) -> None:
    with pytest.raises(InvalidInput, match=r"names the plug-in planner 'evil:plan'.* expected --allow-plugin"):
        parse_options("ground", [str(with_plugin)])
    with pytest.raises(InvalidInput, match="expected --allow-plugin"):
        choose(str(with_plugin), seed=7)
    assert parse_options("ground", [str(with_plugin), "--allow-plugin"]).scenario.ground.planner == "evil:plan"
    chosen = choose(str(with_plugin), allow_plugin=True)
    assert parse_options("ground", [str(with_plugin), *chosen.flags]).scenario == chosen.scenario


def test_a_planner_that_the_user_names_needs_no_further_leave(with_plugin: Path) -> None:
    for chosen in (choose("short", planner="my:plan"), choose(str(with_plugin), planner="tour")):
        assert parse_options("ground", [str(chosen.path), *chosen.flags]).scenario == chosen.scenario
