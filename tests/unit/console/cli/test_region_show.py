"""``he3 region show``: what is not given is not shown as 0, and a site in a projection of its own has its place."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from services.console.__main__ import main

FIELD = np.add.outer(np.arange(12.0), np.arange(10.0)) / 4.0 + 3.0
OPEN = np.ones(FIELD.shape, dtype=bool)


@pytest.fixture
def shown(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> Any:
    def show(**arrays: Any) -> tuple[str, dict[str, Any]]:
        """The text and the JSON document of a region of these arrays."""
        np.savez(tmp_path / "own.npz", he3_ppb=FIELD, resolution_m=5.0, **arrays)
        assert main(["region", "show", str(tmp_path / "own.npz")]) == 0
        text = capsys.readouterr().out
        assert main(["region", "show", str(tmp_path / "own.npz"), "--json"]) == 0
        return text, json.loads(capsys.readouterr().out)

    return show


def test_a_region_without_heights_has_no_relief_and_no_slopes(shown: Any) -> None:
    text, document = shown(traversable=OPEN)
    assert "elevation     none is given" in text
    assert "slope  " not in text
    assert document["relief_m"] is document["slope_median_deg"] is document["slope_max_deg"] is None
    text, document = shown(elevation_m=FIELD)
    assert "slope  " in text
    assert document["relief_m"] == np.ptp(FIELD)


def test_a_region_without_latitude_and_longitude_has_its_place_in_its_projection(
    tmp_path: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    rasterio = pytest.importorskip("rasterio")
    crs, place = "+proj=stere +lat_0=-90 +R=1737400 +units=m", {"width": 10, "height": 12, "count": 1}
    lines = [
        'format = "he3-region"', "version = 1", 'kind = "site"', 'name = "own"', 'title = "own"', 'provenance = "own"',
        "resolution_m = 5.0", f'crs = "{crs}"', "origin_x_m = 700.0", "origin_y_m = -900.0",
    ]  # fmt: skip
    for name, values in (("he3_ppb", FIELD.astype(np.float32)), ("traversable", OPEN.astype(np.uint8))):
        transform = rasterio.Affine(5.0, 0.0, 700.0, 0.0, -5.0, -840.0)
        facts = {"crs": crs, "transform": transform, "dtype": values.dtype.name, **place}
        with rasterio.open(tmp_path / f"{name}.tif", "w", driver="GTiff", **facts) as target:
            target.write(np.flipud(values), 1)
        lines += [f"[layers.{name}]", 'kind = "real"', 'source = "own"', f'file = "{name}.tif"']
    (tmp_path / "region.toml").write_text("\n".join(lines) + "\n")
    assert main(["region", "show", str(tmp_path)]) == 0
    assert f"origin        700.0 m, -900.0 m, south-west corner in {crs}" in capsys.readouterr().out
    assert main(["region", "show", str(tmp_path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["origin_x_m"], document["origin_y_m"], document["crs"]) == (700.0, -900.0, crs)
