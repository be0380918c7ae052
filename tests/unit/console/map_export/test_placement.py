"""Where a site lies on the Moon, also beside a pole and over it."""

from __future__ import annotations

import numpy as np
import pytest

from he3.constants import MOON_RADIUS_M
from schemas.maps import MapRegion

pytest.importorskip("pyproj")

from services.console.map_export.placement import placed


@pytest.mark.parametrize(
    ("latitude", "longitude"), [(89.5, 20.0), (89.995, 120.0), (-90.0, 0.0), (-89.99, -75.0), (20.0, 30.0)]
)
def test_the_corner_is_where_it_was_stated_and_the_sites_metres_are_those_of_the_ground(
    latitude: float, longitude: float
) -> None:
    region = MapRegion(
        name="made", title="Made", location="made.npz", field_seed=None, provenance="made", rows=100, columns=100,
        resolution_m=10.0, origin_lat_deg=latitude, origin_lon_deg=longitude, crs="", origin_x_m=None, origin_y_m=None,
        layers=(),
    )  # fmt: skip
    corners = np.array([(0.0, 0.0), (1000.0, 0.0), (1000.0, 1000.0), (0.0, 1000.0), (500.0, 500.0)])
    degrees = placed(region).degrees(corners)
    assert degrees is not None
    lon, lat = np.radians(degrees).T
    assert np.degrees(lat[0]) == pytest.approx(latitude, abs=1e-7)
    if abs(latitude) < 90.0:
        assert np.degrees(np.sin(lon[0] - np.radians(longitude))) == pytest.approx(0.0, abs=1e-6)
    points = MOON_RADIUS_M * np.column_stack((np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)))
    for a in range(5):
        for b in range(a):
            metres = np.hypot(*(corners[a] - corners[b]))
            assert np.linalg.norm(points[a] - points[b]) == pytest.approx(metres, rel=2e-4)
