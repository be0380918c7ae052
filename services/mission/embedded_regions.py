"""The names of the embedded regions: for services that do not load them, such as the rover."""

from collections.abc import Mapping
from typing import Final

EMBEDDED: Final[Mapping[str, str]] = {
    "t1": "t1_taurus_littrow_synthetic_standin",
    "t2": "t2_hadley_rille_synthetic_standin",
}
"""Name of a region -> its folder in this package: synthetic stand-ins, as their names say."""
