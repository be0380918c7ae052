"""The libraries of the extra ``geo``, imported when they are needed."""

from __future__ import annotations

import importlib
from typing import Any

from he3.errors import He3Error


def rasterio() -> Any:
    """GDAL's Python interface; raises He3Error that names the extra where it is missing."""
    library = _imported("rasterio")
    _imported("rasterio.shutil")
    return library


def pyproj() -> Any:
    """PROJ's Python interface; raises He3Error that names the extra where it is missing."""
    return _imported("pyproj")


def pyogrio() -> Any:
    """OGR's Python interface; raises He3Error that names the extra where it is missing."""
    return _imported("pyogrio")


def pystac() -> Any:
    """The library for STAC; raises He3Error that names the extra where it is missing."""
    return _imported("pystac")


def _imported(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise He3Error(f"expected {name}, which is not installed: pip install he3-seeker[geo]") from None
