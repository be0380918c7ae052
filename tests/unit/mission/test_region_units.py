"""Units of the rasters that a region is built from, and numbers that a file scales."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from he3.errors import InvalidInput
from tests.unit.mission.test_region_build import Array, build, chemistry_of_levels, measured_with, rasterio

LEVELS = {"he3_ppb": 5.0, "iron_wt": 14.0, "titanium_wt": 3.0, "maturity": 0.2, "rock_abundance": 0.004}


def marked(folder: Path, layer: str, numbers: Array, dtype: str = "float32", **facts: Any) -> dict[str, Any]:
    """A recipe in which that layer is a raster of those numbers (96, 96), whose file names units, scales, offsets."""
    document = chemistry_of_levels(folder)
    document["layers"]["rock_abundance"] = {"file": "rock_abundance.tif", "source": "made"}
    document["layers"] = measured_with(document["layers"], layer)
    with rasterio.open(folder / "iron_wt.tif") as example:
        profile = example.profile | {"dtype": dtype}
    with rasterio.open(folder / f"{layer}.tif", "w", **profile) as target:
        target.write(numbers.astype(dtype), 1)
        for key, value in facts.items():
            setattr(target, key, value if key == "nodata" else (value,))
    return document


def sloping(level: float) -> Array:
    """Values (96, 96) that hardly vary about a level."""
    return level * (1.0 + 1e-4 * np.arange(96)) + np.zeros((96, 1))


@pytest.mark.parametrize(
    ("layer", "unit", "factor"),
    [
        ("he3_ppb", "ppb", 1.0),
        ("he3_ppb", "ng/g", 1.0),
        ("he3_ppb", "ppm", 1e-3),
        ("he3_ppb", "\u00b5g/g", 1e-3),
        ("iron_wt", "Weight Percent", 1.0),
        ("iron_wt", "wt. %", 1.0),
        ("titanium_wt", "ppm", 1e4),
        ("titanium_wt", "fraction", 0.01),
        ("maturity", "unitless", 1.0),
        ("rock_abundance", "percent", 100.0),
    ],
)
def test_values_are_converted_from_the_unit_that_the_file_names(
    tmp_path: Path, layer: str, unit: str, factor: float
) -> None:
    numbers = sloping(LEVELS[layer])
    plain_region = build(marked(tmp_path, layer, numbers), tmp_path)
    converted = build(marked(tmp_path, layer, numbers * factor, units=unit), tmp_path)
    assert np.allclose(converted.he3_ppb, plain_region.he3_ppb, rtol=1e-5)
    with rasterio.open(tmp_path / "out" / f"{layer}.tif") as built:
        assert built.read(1).mean() == pytest.approx(numbers.mean(), rel=0.01)


@pytest.mark.parametrize("by", ["file", "recipe"])
@pytest.mark.parametrize(
    ("layer", "unit"),
    [("he3_ppb", "wt%"), ("he3_ppb", "fraction"), ("iron_wt", "km"), ("maturity", "ppb"), ("rock_abundance", "ppm")],
)
def test_a_unit_that_a_layer_cannot_have_is_refused(tmp_path: Path, layer: str, unit: str, by: str) -> None:
    document = marked(tmp_path, layer, sloping(LEVELS[layer]), **({"units": unit} if by == "file" else {}))
    document["layers"][layer] |= {"unit": unit} if by == "recipe" else {}
    with pytest.raises(InvalidInput, match=rf"layer {layer}: expected unit .* got '{unit}'"):
        build(document, tmp_path)


def test_a_scale_of_the_recipe_beside_another_unit_of_the_file_needs_the_recipes_unit(tmp_path: Path) -> None:
    document = marked(tmp_path, "he3_ppb", sloping(0.005), units="ppm")
    document["layers"]["he3_ppb"]["scale"] = 1000.0
    with pytest.raises(InvalidInput, match=r"expected key unit, .* as the file's own unit is 'ppm'"):
        build(document, tmp_path)
    document["layers"]["he3_ppb"]["unit"] = "ppb"
    assert build(document, tmp_path).he3_ppb.mean() == pytest.approx(5.0, rel=0.01)


@pytest.mark.parametrize(("scale", "offset"), [(0.001, 14.0), (-0.001, 20.0), (0.001, 0.0)])
def test_an_integer_raster_is_scaled_before_its_values_are_compared_with_zero(
    tmp_path: Path, scale: float, offset: float
) -> None:
    wanted = np.linspace(13.8, 14.2, 96) + np.zeros((96, 1))  # with an offset of 14 half of the numbers are negative
    numbers = np.rint((wanted - offset) / scale)
    document = marked(tmp_path, "iron_wt", numbers, "int16", scales=scale, offsets=offset)
    build(document, tmp_path)
    with rasterio.open(tmp_path / "out" / "iron_wt.tif") as built:
        values = built.read(1)
    assert 13.8 < values.min() < values.max() < 14.2


def test_a_scaled_value_of_zero_is_missing_where_zero_is(tmp_path: Path) -> None:
    wanted = np.full((96, 96), 3.0)
    wanted[46:50, 46:50] = 0.0
    document = marked(tmp_path, "titanium_wt", np.rint((wanted - 2.1) / 0.3), "int16", scales=0.3, offsets=2.1)
    document["layers"]["titanium_wt"]["zero_is_missing"] = True
    with pytest.raises(InvalidInput, match="got missing ones below"):
        build(document, tmp_path)


def test_cells_of_which_nothing_is_known_have_the_no_data_value_for_other_readers(tmp_path: Path) -> None:
    numbers = sloping(5.0)
    numbers[46:50, 46:50] = -77.0
    document = marked(tmp_path, "he3_ppb", numbers, nodata=-77.0)
    document["layers"]["he3_ppb"]["mask_holes"] = True
    region = build(document, tmp_path)
    assert region.known is not None
    with rasterio.open(tmp_path / "out" / "he3_ppb.tif") as built:
        shown = built.read(1, masked=True)
    assert (shown.mask == ~region.known[::-1]).all()
    assert shown.mask.any()
