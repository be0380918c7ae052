"""The libraries of the extra ``geo``, imported when they are needed."""

from __future__ import annotations

import importlib
from typing import Any

from he3.errors import He3Error


def rasterio() -> Any:
    """GDAL's Python interface; raises He3Error that names the extra where it is missing."""
    return _imported("rasterio")


def pyproj() -> Any:
    """PROJ's Python interface; raises He3Error that names the extra where it is missing."""
    return _imported("pyproj")


def _imported(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise He3Error(f"expected {name}, which is not installed: pip install he3-seeker[geo]") from None
