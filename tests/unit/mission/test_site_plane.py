"""The cells of a site are squares of their size on the ground, wherever it lies and however wide it is."""

from __future__ import annotations

import numpy as np
import pytest

from he3.constants import MOON_RADIUS_M
from he3.frames import SiteGrid
from services.mission.region_build.projection import MOON_SPHERE, SitePlane, array_crs, site_plane, transformer

pytest.importorskip("pyproj")


def sides_m(plane: SitePlane) -> tuple[np.ndarray, np.ndarray]:
    """Distances [m] on the ground between neighbouring cells, east and north, over the whole site."""
    longitude, latitude = transformer(plane.crs, MOON_SPHERE).transform(*plane.centres())
    lon, lat = np.radians(longitude), np.radians(latitude)
    places = MOON_RADIUS_M * np.stack((np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)))
    east, north = (np.linalg.norm(np.diff(places, axis=axis), axis=0) for axis in (2, 1))
    return east, north


@pytest.mark.parametrize("width_km", [1, 20, 100])
@pytest.mark.parametrize("latitude", [0.0, 20.19, -45.0, 60.0, 64.9, -66.0, 80.0, -89.9, -90.0])
def test_cells_are_squares_of_their_size_on_the_ground(latitude: float, width_km: int) -> None:
    cell = width_km * 1000.0 / 50
    east, north = sides_m(site_plane(latitude, 100.0, SiteGrid(50, 50, cell)))
    for sides in (east, north):
        assert np.abs(sides / cell - 1.0).max() < 0.0105
        assert sides.mean() == pytest.approx(cell, rel=0.003)


def test_sites_of_a_few_kilometres_stay_equirectangular_and_have_latitude_and_longitude() -> None:
    for latitude, side in ((20.19, 50_000.0), (60.0, 10_000.0)):
        plane = site_plane(latitude, 30.8, SiteGrid(50, 50, side / 50))
        assert plane.has_origin
        assert "+proj=eqc" in plane.crs


@pytest.mark.parametrize("latitude", [0.0, 20.19, -45.0, 66.0, 89.9, -89.0, -90.0])
def test_pixels_of_an_array_lie_as_far_from_its_centre_as_it_says(latitude: float) -> None:
    x, y = np.array([0.0, 5000.0, -5000.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 5000.0, -5000.0])
    longitude, found = transformer(array_crs(latitude, 30.0, 10_000.0), MOON_SPHERE).transform(x, y)
    lon, lat = np.radians(longitude), np.radians(found)
    places = MOON_RADIUS_M * np.column_stack((np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)))
    assert found[0] == pytest.approx(latitude)
    assert np.linalg.norm(places[1:] - places[0], axis=1) == pytest.approx(5000.0, rel=1e-3)
    east, west, north, south = places[1:]
    assert np.linalg.norm(east - west) == pytest.approx(10_000.0, rel=1e-3)
    assert (east - west) @ (north - south) == pytest.approx(0.0, abs=1e4)
