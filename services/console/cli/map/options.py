"""Flags and arguments of ``he3 map``, described and checked once."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.options import MAX_PPB, checked, one_of, within

if TYPE_CHECKING:
    pass

_AS_OF = re.compile(r"\d{1,19}|\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d(\.\d{1,9})?)?Z?")


def _layer(name: str) -> str:
    from he3.errors import InvalidInput
    from schemas.maps import RASTERS

    if name not in RASTERS:
        raise InvalidInput(f"expected a layer out of {', '.join(RASTERS)}; got '{name}'")
    return name


def _as_of(text: str) -> str:
    from he3.errors import InvalidInput

    if not _AS_OF.fullmatch(text):
        raise InvalidInput(f"expected a revision, or a time such as 2030-01-01T06:00:00Z, got '{text}'")
    return text


LayerName = Annotated[
    str,
    typer.Argument(metavar="LAYER",
                   help="mean, std, information, exceedance (with --threshold), traversable, elevation, slope, shade, "
                   "or of a simulated Moon: reference, error.",
                   callback=checked(_layer),
                   autocompletion=one_of("mean", "std", "information", "exceedance", "traversable", "elevation",
                                         "slope", "shade", "reference", "error")),
]  # fmt: skip
Threshold = Annotated[
    float | None,
    typer.Option("--threshold", metavar="PPB", help="Abundance for the probability of exceedance.",
                 callback=within(0, MAX_PPB)),
]  # fmt: skip
AsOf = Annotated[
    str | None,
    typer.Option("--as-of", metavar="WHEN", help="An earlier map: a revision, or a time such as 2030-01-01T06:00:00Z.",
                 callback=checked(_as_of)),
]  # fmt: skip
MIN_WIDTH = 10
Width = Annotated[
    int | None,
    typer.Option("--width", metavar="N", help="Characters across (10 to 250), instead of as many as there is room for.",
                 callback=within(MIN_WIDTH, 250)),
]  # fmt: skip
AsCsv = Annotated[bool, typer.Option("--csv", help="Print comma-separated values.")]


def check_threshold(layer: str, threshold: float | None) -> None:
    """Raise InvalidInput unless a threshold is given with the layer exceedance, and only there."""
    from he3.errors import InvalidInput

    if (layer == "exceedance") != (threshold is not None):
        got = "none" if threshold is None else f"--threshold {threshold:g}"
        raise InvalidInput(f"--threshold: expected it with the layer exceedance and only there, got {got} for {layer}")
