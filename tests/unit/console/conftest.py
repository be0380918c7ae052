"""A mission that was flown with faults, once for all tests of the console."""

from __future__ import annotations

import pytest

from tests.unit.console.flown import Flown, fly


@pytest.fixture(scope="session")
def flown_with_faults(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    return fly(tmp_path_factory.mktemp("flown") / "mission.mcap")
