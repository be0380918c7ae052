"""The names of the embedded regions: for services that do not load them, such as the rover."""

from collections.abc import Mapping
from typing import Final

EMBEDDED: Final[Mapping[str, str]] = {
    "t1": "t1_taurus_littrow_synthetic_standin.npz",
    "t2": "t2_hadley_rille_synthetic_standin.npz",
}
"""Name of a region -> its coarse rasters in this package: synthetic stand-ins, as their file names say."""
