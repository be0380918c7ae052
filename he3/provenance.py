"""The origins of a region's layers: one record per layer, and one line for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum


class OriginKind(StrEnum):
    """Kind of a layer's source."""

    REAL = "real"  # measured at this place
    DERIVED = "derived"  # computed from other layers of the region
    ASSUMED = "assumed"  # a value that was chosen for want of a measurement
    SYNTHETIC = "synthetic"  # drawn, or measured at another place


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerOrigin:
    """The origin of one layer of a region. Unknown texts are empty."""

    layer: str
    kind: OriginKind
    source: str
    """Short description: a product, a relation, an assumption."""
    file: str = ""
    """Name of the raster that it was read from."""
    sha256: str = ""
    """Checksum of that raster, or of the bytes of the window."""
    window: str = ""
    product_id: str = ""
    citation: str = ""

    def line(self) -> str:
        """The whole record in one line."""
        parts = [f"{self.layer} {self.kind.value}: {self.source}"]
        parts += [f"{name} {text}" for name, text in (("product", self.product_id), ("file", self.file),
                  ("window", self.window), ("cite", self.citation)) if text]  # fmt: skip
        parts += [f"sha256 {self.sha256[:16]}"] if self.sha256 else []
        return ", ".join(parts)


def summary(layers: Sequence[LayerOrigin]) -> str:
    """The layers in one line, by kind of source: ``real elevation_m, iron_wt; assumed maturity (OMAT 0.2)``."""
    parts = []
    for kind in OriginKind:
        names = [
            origin.layer if kind in (OriginKind.REAL, OriginKind.DERIVED) else f"{origin.layer} ({origin.source})"
            for origin in layers
            if origin.kind is kind
        ]
        if names:
            parts.append(f"{kind.value.upper()} {', '.join(names)}")
    return "; ".join(parts)
