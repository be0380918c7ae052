"""Paths of the scenarios and Zenoh configurations that ship with the system: in the checkout or the package."""

from __future__ import annotations

import sys
from pathlib import Path

from he3.errors import InvalidInput

_INSTALLED = Path(__file__).parent / "deploy"
_CHECKOUT = Path(__file__).parents[2] / "deploy"


RENAMED = {"t1-nominal": "t1-paper", "t2-nominal": "t2-paper"}
"""Former names of shipped scenarios, and their present ones."""


def deployment(*parts: str) -> Path:
    """Path of a file that ships with the system, such as ``deployment("zenoh", "moon-client.json5")``."""
    return (_INSTALLED if _INSTALLED.is_dir() else _CHECKOUT).joinpath(*parts)


def shipped_scenarios() -> list[str]:
    """Names of the scenarios that ship with the system."""
    return sorted(path.stem for path in deployment("scenarios").glob("*.toml"))


def find_scenario(reference: str) -> Path:
    """Path of a scenario, given as a file or as the name of a shipped one; raises InvalidInput.

    A former name still works; one line on standard error gives the present name.
    """
    path = Path(reference)
    if path.suffix == ".toml" or path.exists():
        return path
    name = RENAMED.get(reference, reference)
    if name != reference:
        better = name.removesuffix("-paper")
        sys.stderr.write(f"he3: {reference} is {name} now, the published protocol; {better} runs the best planner\n")
    shipped = deployment("scenarios", f"{name}.toml")
    if shipped.is_file():
        return shipped
    raise InvalidInput(
        f"{reference}: expected a scenario file or one of {', '.join(shipped_scenarios())}; found neither"
    )
