"""Every constant has its source, and agrees with well-known figures."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

import pytest

from he3 import constants

SOURCES = ("BIPM", "IAU", "ALMANAC", "PRODUCTS", "LOLA", "FA-JIN", "PAPER", "SOURCEBOOK", "ASSUMED", "by definition")


def test_every_constant_has_a_comment_with_unit_and_source() -> None:
    lines = Path(constants.__file__).read_text(encoding="utf-8").splitlines()
    found = 0
    for before, line in itertools.pairwise(lines):
        if re.match(r"[A-Z0-9_]+: Final = ", line):
            found += 1
            comment = line.partition("#")[2] or before.partition("#")[2]
            assert any(source in comment for source in SOURCES), line
    assert found >= 20


def test_every_source_that_is_cited_is_explained() -> None:
    assert constants.__doc__ is not None
    for source in SOURCES[:-1]:
        assert f"  {source} " in constants.__doc__


def test_a_lunar_degree_is_thirty_kilometres() -> None:
    assert math.radians(1) * constants.MOON_RADIUS_M == pytest.approx(30_323.35, abs=0.01)


def test_an_orbital_pixel_is_about_59_metres() -> None:
    pixel_m = math.radians(1) * constants.MOON_RADIUS_M / constants.ORBITAL_PIXELS_PER_DEGREE
    assert pixel_m == pytest.approx(59.2, abs=0.05)


def test_the_published_fluxes_cannot_be_changed_by_accident() -> None:
    with pytest.raises(TypeError):
        constants.PUBLISHED_FLUX["apollo-17"] = 0.6  # type: ignore[index]
