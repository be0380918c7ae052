"""Settings of the whole suite: one BLAS thread, as in production, and one profile of hypothesis."""

import os
import signal

from services.runtime.instructions import common_instructions

# Set before numpy is imported; `services.runtime.entry` says why.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.update({**common_instructions(), **os.environ})

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

# No bound of wall time on an example: the gate has to be green on a slow machine too. The examples follow from the
# test's own source, so that a failing run is due to the present change; `--hypothesis-profile=search` draws new ones.
settings.register_profile(
    "gate", deadline=None, print_blob=True, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("search", settings.get_profile("gate"), derandomize=False)
settings.load_profile("gate")

# A shell starts a command in the background with SIGINT ignored, and all its children inherit that. Tests of Ctrl-C
# start processes that must not.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _own_runtime_folder(tmp_path_factory):
    """No command of a test finds a mission that a test in another process has started."""
    os.environ["XDG_RUNTIME_DIR"] = str(tmp_path_factory.mktemp("runtime"))


@pytest.fixture(scope="session")
def quarter_of_t1(tmp_path_factory):
    """A region file with a quarter of t1, every second cell: 125 x 125 cells of 2 m."""
    from services.mission.regions import load_region

    whole = load_region("t1")
    path = tmp_path_factory.mktemp("region") / "quarter.npz"
    np.savez(
        path, he3_ppb=whole.he3_ppb[:250:2, :250:2], traversable=whole.traversable[:250:2, :250:2], resolution_m=2.0
    )
    return path


@pytest.fixture(scope="session")
def coarse_t1(tmp_path_factory):
    """A region file with all of t1, every fourth cell: 125 x 125 cells of 4 m, whose maps cost next to nothing."""
    from services.mission.regions import load_region

    whole = load_region("t1")
    path = tmp_path_factory.mktemp("region") / "coarse.npz"
    np.savez(path, he3_ppb=whole.he3_ppb[2::4, 2::4], traversable=whole.traversable[2::4, 2::4], resolution_m=4.0)
    return path
