"""Before any test imports numpy: one BLAS thread, as in production (he3/__init__.py says why)."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest


@pytest.fixture(scope="session")
def quarter_of_t1(tmp_path_factory):
    """A quarter of t1 as somebody's own region file, every second cell: 125 x 125 cells of 2 m."""
    from services.mission.regions import load_region

    whole = load_region("t1")
    path = tmp_path_factory.mktemp("region") / "quarter.npz"
    np.savez(
        path, he3_ppb=whole.he3_ppb[:250:2, :250:2], traversable=whole.traversable[:250:2, :250:2], resolution_m=2.0
    )
    return path
