"""What a result depends on apart from its arguments: the software, a region's data, a plug-in planner's source."""

from __future__ import annotations

import hashlib
import platform
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from he3.errors import InvalidInput
from services.runtime.child import ROOT
from services.runtime.heartbeat import software_version
from services.runtime.instructions import instructions

if TYPE_CHECKING:
    from he3.reference import Region

_FLIES: Final = ("he3", "schemas", "services")
_NOT_FLOWN: Final = ("services/console", "services/recorder")
"""Parts of the system that no result depends on: an edit of the page is no reason to fly again."""
_FLOWN_TOO: Final = ("services/console/campaign/mission_task.py", "services/console/report/mission_report.py")
"""Files in those parts that make a mission's row."""
_LIBRARIES: Final = ("numpy", "scipy", "ompl")
_LAYERS: Final = ("he3_ppb", "orbital_ppb", "elevation_m", "slope_deg", "traversable")


@cache
def software_identity(package: str = "services") -> str:
    """Version of the system, of Python and of the libraries that compute, with a digest of the source that flies, and
    the processor instructions that they compute with.

    package: of the function that computes, such as ``benchmarks``, whose source counts, too. A checkout whose source
    has changed is another software, whatever its version says.
    """
    root = Path(ROOT)
    digest = hashlib.sha256()
    for folder in dict.fromkeys((*_FLIES, package)):
        for path in sorted((root / folder).rglob("*.py")):
            name = path.relative_to(root).as_posix()
            if not name.startswith(_NOT_FLOWN) or name in _FLOWN_TOO:
                digest.update(f"{name}\n".encode())
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    python = ".".join(platform.python_version_tuple()[:2])
    libraries = " ".join(f"{name}-{_version(name)}" for name in _LIBRARIES)
    return f"he3-seeker-{software_version()}+{digest.hexdigest()[:12]} python-{python} {libraries} {instructions()}"


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "none"


@cache
def region_checksum(name: str) -> str:
    """SHA-256 of the data of a region in its own variation, in hexadecimal; raises InvalidInput as its loading does."""
    return checksum_of(kept_region(name, None))


@lru_cache(maxsize=4)
def kept_region(name: str, field_seed: int | None) -> Region:
    """The region as `load_region` loads it, kept for the missions that follow."""
    from services.mission.regions import load_region

    return load_region(name, field_seed)


def checksum_of(region: Region) -> str:
    """SHA-256 of the layers and the grid of a region, in hexadecimal."""
    import numpy as np

    digest = hashlib.sha256(f"{region.grid.rows} {region.grid.columns} {region.grid.resolution_m!r}\n".encode())
    for name in _LAYERS:
        layer: Any = np.ascontiguousarray(getattr(region, name))
        digest.update(f"{name} {layer.dtype.str}\n".encode())
        digest.update(layer.tobytes())
    return digest.hexdigest()


def planner_checksum(name: str) -> str:
    """SHA-256 of the source of a plug-in planner's module; empty for a built-in one, whose source is the software's.

    Raises InvalidInput for a module that is found neither on Python's path nor in the working directory.
    """
    if ":" not in name:
        return ""
    module = name.partition(":")[0]
    try:
        spec = find_spec(module)
    except (ImportError, ValueError):
        spec = None
    origin = None if spec is None or spec.origin is None else Path(spec.origin)
    if origin is None or not origin.is_file():
        origin = Path.cwd().joinpath(*module.split(".")).with_suffix(".py")
    try:
        return hashlib.sha256(origin.read_bytes()).hexdigest()
    except OSError:
        raise InvalidInput(
            f"planner {name}: expected a module on Python's path or in the working directory, got none"
        ) from None
