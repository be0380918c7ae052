"""Colours of the exported layers: colour tables for classes, and styles that QGIS loads with a raster of its name."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from he3.colour_maps import stops

if TYPE_CHECKING:
    from services.console.map_export.contents import RasterLayer


def class_colours(layer: RasterLayer) -> dict[int, tuple[int, int, int, int]]:
    """Value -> (red, green, blue, alpha), 0 to 255, of a layer of classes."""
    colours = stops(layer.colours)
    last = len(layer.classes) - 1
    return {
        value: (*bytes.fromhex(colours[round(index / max(last, 1) * (len(colours) - 1))][1:]), 255)
        for index, value in enumerate(layer.classes)
    }


def qgis_style(layer: RasterLayer) -> str:
    """A QGIS layer style (.qml) of the layer."""
    renderer = _of_classes(layer) if layer.classes else _of_values(layer)
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
        '<qgis version="3.22.0" styleCategories="Symbology">\n <pipe>\n'
        f"{renderer}\n"
        ' </pipe>\n <blendMode>0</blendMode>\n</qgis>\n'
    )  # fmt: skip


def _of_values(layer: RasterLayer) -> str:
    low, high = layer.span or (float(layer.values.min()), float(layer.values.max()))
    colours = stops(layer.colours)
    step = (high - low) / (len(colours) - 1)
    unit = "" if layer.unit == "1" else f" {layer.unit}"
    items = "\n".join(
        f'     <item value="{low + index * step!r}" color="{colour}" alpha="255" '
        f"label={quoteattr(f'{low + index * step:.4g}{unit}')}/>"
        for index, colour in enumerate(colours)
    )
    return (
        '  <rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" alphaBand="-1" '
        f'classificationMin="{low!r}" classificationMax="{high!r}">\n'
        "   <rasterTransparency/>\n   <rastershader>\n"
        f'    <colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0" minimumValue="{low!r}" '
        f'maximumValue="{high!r}">\n{items}\n    </colorrampshader>\n   </rastershader>\n  </rasterrenderer>'
    )


def _of_classes(layer: RasterLayer) -> str:
    entries = "\n".join(
        f'    <paletteEntry value="{value}" color="#{bytes(colour[:3]).hex()}" alpha="255" '
        f"label={quoteattr(layer.classes[value])}/>"
        for value, colour in class_colours(layer).items()
    )
    return (
        '  <rasterrenderer type="paletted" band="1" opacity="1" alphaBand="-1">\n   <rasterTransparency/>\n'
        f"   <colorPalette>\n{entries}\n   </colorPalette>\n  </rasterrenderer>"
    )
