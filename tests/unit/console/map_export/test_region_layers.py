"""What the region adds to an exported map: only of the mission's own region."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from he3.errors import InvalidInput
from services.console.map_export.region_layers import loaded_region
from services.ground.map.region_account import region_account
from services.mission.region_folder import is_recorded, provenance_of
from services.mission.region_identity import is_region
from services.mission.regions import load_region
from services.mission.scenario import Scenario


def test_only_the_missions_own_region_is_taken() -> None:
    own, other = load_region("t1"), load_region("t2")
    account = region_account(Scenario(name="t1", region="t1"), own)
    assert is_region(own, account)
    assert not is_region(other, account)
    assert not isinstance(loaded_region(account), str)
    with pytest.raises(InvalidInput, match="t2: expected the mission's region 't1', got another region"):
        loaded_region(account, "t2")


def test_a_region_that_is_on_another_machine_is_left_out_with_a_line() -> None:
    account = region_account(Scenario(name="t1", region="/elsewhere/place"), load_region("t1"))
    line = loaded_region(account)
    assert isinstance(line, str)
    assert line.startswith("elevation, slope, orbital map and reference are left out: ")
    with pytest.raises(InvalidInput):
        loaded_region(account, "/not/there.npz")


def test_a_region_in_one_file_that_has_changed_since_is_another_one(tmp_path: Path) -> None:
    path, copy = tmp_path / "place.npz", tmp_path / "copy" / "place.npz"
    field = np.linspace(4.0, 8.0, 400).reshape(20, 20)
    arrays = {"he3_ppb": field, "resolution_m": 5.0, "traversable": np.ones((20, 20), dtype=np.bool_)}
    np.savez(path, **arrays)
    copy.parent.mkdir()
    shutil.copy(path, copy)
    account = region_account(Scenario(name="m", region=str(path)), load_region(str(path)))
    recorded = provenance_of(path)
    assert not isinstance(loaded_region(account), str)
    assert not isinstance(loaded_region(account, str(copy)), str)
    assert is_recorded(copy, recorded)
    np.savez(path, **arrays | {"he3_ppb": field[::-1]})
    assert loaded_region(account) == (
        f"elevation, slope, orbital map and reference are left out: {path}: expected the mission's region 'place', got "
        "another region"
    )
    assert not is_recorded(path, recorded)
    assert is_recorded(path, {"region": str(path)})
