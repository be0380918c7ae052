"""The embedded regions against the published figures, and region files with every possible error."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import zipfile
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from he3.errors import InvalidInput
from he3.terrain import reachable
from services.console.cli.region import build
from services.mission import regions
from services.mission.embedded_regions import EMBEDDED
from services.mission.region_folder import read_document
from services.mission.regions import MAX_FILE_BYTES, load_region, load_window
from services.mission.tiff import read_tiff

# Minimum, maximum, mean [ppb] and the share that is not traversable, as published.
PUBLISHED = {"t1": (4.82, 13.47, 7.88, 0.0991), "t2": (3.62, 8.60, 5.50, 0.1301)}
SCRIPT = Path(__file__).parents[3] / "scripts" / "make_standin_regions.py"


@pytest.mark.parametrize("name", PUBLISHED)
def test_an_embedded_region_agrees_with_the_published_figures_within_five_percent(name: str) -> None:
    region = load_region(name)
    he3 = region.he3_ppb
    got = (he3.min(), he3.max(), he3.mean(), region.untraversable_fraction)
    assert got == pytest.approx(PUBLISHED[name], rel=0.05)
    assert region.grid.shape == (500, 500)
    assert region.grid.resolution_m == 1.0


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_rover_at_the_start_can_reach_nearly_all_open_ground_and_never_over_the_slope_limit(name: str) -> None:
    region = load_region(name)
    connected = reachable(region.traversable, region.grid, (25.0, 25.0))
    assert connected.sum() >= 0.97 * region.traversable.sum()
    assert region.slope_deg[region.traversable].max() <= 15.0
    assert region.traversable[20:31, 20:31].all()  # room to stand at the start


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_orbital_map_knows_the_region_in_part_and_without_bias(name: str) -> None:
    region = load_region(name)
    he3, orbital = region.he3_ppb.ravel(), region.orbital_ppb.ravel()
    assert orbital.mean() == pytest.approx(he3.mean(), rel=0.03)
    assert 0.4 < np.corrcoef(he3, orbital)[0, 1] < 0.8
    assert np.polyfit(orbital, he3, 1)[0] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("name", "published_rmse"), [("t1", (0.8347, 0.8517)), ("t2", (0.4949, 0.5318))])
def test_a_map_from_150_random_samples_is_about_as_wrong_as_the_published_ones(
    name: str, published_rmse: tuple[float, float]
) -> None:
    """Simple kriging with the pipeline's own kind of covariance, over five draws of places; no tuning."""
    region = load_region(name)
    points, truth = region.grid.points(), region.he3_ppb.ravel()
    cells = np.arange(0, truth.size, 23)
    errors = []
    for seed in range(5):
        random = np.random.default_rng(seed)
        drilled = random.choice(np.flatnonzero(region.traversable), 150, replace=False)
        measured = truth[drilled] + 0.1 * random.standard_normal(150)
        variance = measured.var()
        among = variance * np.exp(-cdist(points[drilled], points[drilled]) / 30) + 0.01 * np.eye(150)
        towards = variance * np.exp(-cdist(points[cells], points[drilled]) / 30)
        mapped = measured.mean() + towards @ np.linalg.solve(among, measured - measured.mean())
        errors.append(np.sqrt(np.mean((mapped - truth[cells]) ** 2)))
    assert 0.92 * min(published_rmse) < np.mean(errors) < 1.02 * max(published_rmse)


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_mean_stays_near_the_published_one_for_other_seeds_too(name: str) -> None:
    first, second = load_region(name, 1001), load_region(name, 1002)
    assert not np.array_equal(first.he3_ppb, second.he3_ppb)
    assert (first.seed, second.seed) == (1001, 1002)
    for region in (first, second):
        assert region.he3_ppb.mean() == pytest.approx(PUBLISHED[name][2], rel=0.05)


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_stand_in_says_that_it_is_one_wherever_it_is_named(name: str) -> None:
    region = load_region(name)
    assert "synthetic_standin" in EMBEDDED[name]
    assert "synthetic stand-in" in region.title
    assert "SYNTHETIC STAND-IN" in region.provenance


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_window_reaches_well_beyond_the_region_and_is_centred_on_the_site(name: str) -> None:
    window = load_window(name)
    sites = {"t1": (20.190, 30.772), "t2": (26.132, 3.633)}
    rows, columns = window.iron_wt.shape
    middle = window.south_deg + rows / 2 / 512, window.west_deg + columns / 2 / 512
    assert middle == pytest.approx(sites[name], abs=1 / 512)
    assert rows >= 3 * 500 / 59.2
    assert window.origin_lat_deg + 250 / 30_323.35 == pytest.approx(sites[name][0], abs=1e-6)


def committed(name: str) -> Path:
    return Path(str(resources.files("services.mission").joinpath("region_data", EMBEDDED[name])))


def test_rasters_on_disk_are_north_up_and_flipped_once() -> None:
    on_disk = read_tiff(committed("t1") / "elevation_m.tif")
    window, north_deg = load_window("t1"), read_document(committed("t1")).window.north_deg  # type: ignore[union-attr]
    assert np.array_equal(window.elevation_m[::-1], on_disk.astype(float))
    assert window.south_deg < north_deg
    assert window.south_deg + on_disk.shape[0] / 512 == pytest.approx(north_deg)


def test_the_committed_script_makes_the_committed_rasters(tmp_path: Path) -> None:
    """Numbers to the precision of float32: transforms differ in their last bits from machine to machine."""
    pytest.importorskip("rasterio")
    subprocess.run(
        [sys.executable, str(SCRIPT), "--out", str(tmp_path)],
        check=True,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": str(SCRIPT.parent.parent)},
    )
    for name in EMBEDDED:
        made, kept = tmp_path / EMBEDDED[name], committed(name)
        one, other = (read_document(folder).model_dump(exclude={"layers"}) for folder in (made, kept))
        assert one == other
        for layer in ("iron_wt", "maturity", "elevation_m"):
            expected = pytest.approx(read_tiff(kept / f"{layer}.tif"), rel=1e-6)
            assert read_tiff(made / f"{layer}.tif") == expected


# ---- files from outside


def arrays(**changes: Any) -> dict[str, Any]:
    random = np.random.default_rng(0)
    content: dict[str, Any] = {
        "he3_ppb": random.uniform(4, 9, (30, 40)),
        "elevation_m": np.zeros((30, 40)),
        "resolution_m": 2.0,
    }
    content.update(changes)
    return {key: value for key, value in content.items() if value is not None}


def saved(path: Path, **changes: Any) -> Path:
    np.savez(path, **arrays(**changes))
    return path


def test_a_file_of_ones_own_becomes_a_region_with_row_0_in_the_south(tmp_path: Path) -> None:
    he3 = np.add.outer(np.arange(30.0), np.arange(40.0)) + 5
    region = load_region(saved(tmp_path / "mine.npz", he3_ppb=he3))
    assert np.array_equal(region.he3_ppb, he3)
    assert (region.name, region.grid.shape, region.grid.resolution_m) == ("mine", (30, 40), 2.0)
    assert region.traversable.all()
    assert "mine.npz" in region.provenance


def test_a_region_written_to_a_file_keeps_its_provenance_and_its_place_on_the_moon(tmp_path: Path) -> None:
    region = load_region("t1")
    for source, name in (("t1", "a.npz"), (str(tmp_path / "a.npz"), "b.npz")):
        build(source, tmp_path / name)
    again, once_more = load_region(tmp_path / "a.npz"), load_region(tmp_path / "b.npz")
    assert "SYNTHETIC STAND-IN" in again.provenance
    assert again.provenance == f"{region.provenance} (from a.npz)"
    assert once_more.provenance == f"{region.provenance} (from a.npz) (from b.npz)"
    assert (once_more.origin_lat_deg, once_more.origin_lon_deg) == (region.origin_lat_deg, region.origin_lon_deg)
    assert np.array_equal(once_more.he3_ppb, region.he3_ppb)


def test_a_file_that_says_nothing_of_its_origin_has_none_and_builds_on(tmp_path: Path) -> None:
    build(str(saved(tmp_path / "mine.npz", provenance="p" * 500)), tmp_path / "again.npz")
    region = load_region(tmp_path / "again.npz")
    assert (region.origin_lat_deg, region.origin_lon_deg) == (None, None)
    assert region.provenance == "p" * 500 + " (from again.npz)"


def test_a_path_may_be_text_and_numbers_may_be_of_any_real_kind(tmp_path: Path) -> None:
    path = saved(tmp_path / "mine.npz", he3_ppb=np.full((30, 40), 6, dtype=np.int16), resolution_m=np.array([1]))
    assert load_region(str(path)).he3_ppb.dtype == np.float64


def test_elevation_closes_ground_by_the_limits_of_a_vehicle_and_the_embedded_regions_by_relief(tmp_path: Path) -> None:
    region = load_region("t1")
    path = tmp_path / "t1_again.npz"
    rocks = np.full(region.grid.shape, 0.004)
    rocks[100:110, 200:230] = 0.3
    layers = {"he3_ppb": region.he3_ppb, "elevation_m": region.elevation_m, "resolution_m": 1.0}
    np.savez(path, **layers)
    again = load_region(path)
    assert again.slope_deg[again.traversable].max() <= 15.0
    assert again.untraversable_fraction < 0.05 < region.untraversable_fraction
    np.savez(path, **layers, rock_abundance=rocks)
    rocky = load_region(path)
    assert np.array_equal(rocky.traversable, again.traversable & (rocks < 0.1))


def test_traversability_that_is_given_wins_over_elevation_and_suffices_alone(tmp_path: Path) -> None:
    mask = np.ones((30, 40), dtype=bool)
    mask[3, 4] = False
    for elevation in (np.zeros((30, 40)), None):
        region = load_region(saved(tmp_path / "mask.npz", traversable=mask, elevation_m=elevation))
        assert np.array_equal(region.traversable, mask)
    zeros_and_ones = load_region(saved(tmp_path / "mask.npz", traversable=mask.astype(np.uint8)))
    assert np.array_equal(zeros_and_ones.traversable, mask)


def test_without_an_orbital_map_the_file_gets_what_an_orbiter_would_see(tmp_path: Path) -> None:
    he3 = 6 + np.add.outer(np.sin(np.arange(300) / 70), np.cos(np.arange(300) / 80))
    region = load_region(saved(tmp_path / "smooth.npz", he3_ppb=he3, elevation_m=np.zeros((300, 300)), resolution_m=1))
    assert np.corrcoef(region.orbital_ppb.ravel(), he3.ravel())[0, 1] > 0.95
    given = load_region(saved(tmp_path / "given.npz", orbital_ppb=np.full((30, 40), 7.0)))
    assert (given.orbital_ppb == 7.0).all()


def test_a_region_of_kilometres_is_judged_by_slope_in_cells_of_any_size(tmp_path: Path) -> None:
    for resolution_m in (50.0, 100.0, 300.0):
        region = load_region(saved(tmp_path / "wide.npz", resolution_m=resolution_m))
        assert region.traversable.all()
        assert np.isfinite(region.orbital_ppb).all()


HOLE = np.full((30, 40), 5.0)
HOLE[7, 9] = np.nan


@pytest.mark.parametrize(
    ("changes", "key", "expectation"),
    [
        ({"he3_ppb": None}, "he3_ppb", "expected key"),
        ({"resolution_m": None}, "resolution_m", "expected key"),
        ({"elevation_m": None}, "elevation_m or traversable", "expected key"),
        ({"he3_ppb": np.full((30, 40), np.nan)}, "he3_ppb", "expected a value in some cell, got NaN in all"),
        (
            {"he3_ppb": HOLE, "traversable": np.isnan(HOLE)},
            "he3_ppb",
            "expected a value in some open cell, got NaN in all of them",
        ),
        ({"elevation_m": HOLE}, "elevation_m", "NaN or infinity in 1 cell, at row 7"),
        (
            {"he3_ppb": -np.ones((30, 40))},
            "he3_ppb",
            "to 1e+06 ppb, got -1 in 1200 cells, the first at row 0, column 0",
        ),
        ({"he3_ppb": np.full((30, 40), 1e9)}, "he3_ppb", "expected 0 to 1e+06 ppb, got 1e+09 in 1200 cells"),
        ({"he3_ppb": np.full((30, 40), 0.012)}, "he3_ppb", "expected helium-3 in ppb, got at most 0.012, as in ppm or"),
        ({"provenance": "x" * 501}, "provenance", "expected up to 500 printable characters, got 501: 'xxx"),
        ({"provenance": "two\nlines"}, "provenance", "expected up to 500 printable characters, got 9"),
        ({"provenance": 7.0}, "provenance", "got dtype float64"),
        ({"provenance": ["a", "b"]}, "provenance", "of shape (2,)"),
        ({"origin_lat_deg": 20.0}, "origin_lon_deg", "both of"),
        ({"origin_lat_deg": 91.0, "origin_lon_deg": 3.0}, "origin_lat_deg", "expected -90 to 90 deg, got 91"),
        ({"origin_lat_deg": 9.0, "origin_lon_deg": np.nan}, "origin_lon_deg", "expected -360 to 360 deg, got nan"),
        ({"he3_ppb": np.ones(30)}, "he3_ppb", "(rows, columns)"),
        ({"he3_ppb": np.ones((2, 40))}, "he3_ppb", "at least 4 x 4"),
        ({"he3_ppb": np.ones((30, 40), dtype=complex)}, "he3_ppb", "got dtype complex128"),
        ({"he3_ppb": np.full((30, 40), "6")}, "he3_ppb", "expected real numbers"),
        ({"elevation_m": np.zeros((40, 30))}, "elevation_m", "(30, 40), got (40, 30)"),
        ({"orbital_ppb": np.zeros((40, 30))}, "orbital_ppb", "(30, 40), got (40, 30)"),
        ({"traversable": np.ones((30, 41), dtype=bool)}, "traversable", "(30, 40), got (30, 41)"),
        ({"traversable": np.full((30, 40), 2)}, "traversable", "expected booleans, got 2 in 1200 cells"),
        ({"traversable": np.where(np.isnan(HOLE), 255, 1)}, "traversable", "got 255 in 1 cell, at row 7, column 9"),
        ({"traversable": np.ones((30, 40))}, "traversable", "got dtype float64"),
        ({"traversable": np.zeros((30, 40), dtype=bool)}, "traversable", "at least one open cell"),
        ({"resolution_m": 0.0}, "resolution_m", "expected 0.01 to 1000 m"),
        ({"resolution_m": np.nan}, "resolution_m", "expected 0.01 to 1000 m"),
        ({"resolution_m": [1.0, 2.0]}, "resolution_m", "expected one number"),
        ({"resolution_m": "1 m"}, "resolution_m", "expected one number"),
        ({"rock_abundance": np.full((30, 40), 3.0)}, "rock_abundance", "expected 0 to 1, or NaN where it is not known"),
        ({"rock_abundance": np.zeros((30, 41))}, "rock_abundance", "(30, 40), got (30, 41)"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line_with_file_key_and_expectation(
    tmp_path: Path, changes: dict[str, Any], key: str, expectation: str
) -> None:
    path = saved(tmp_path / "wrong.npz", **changes)
    with pytest.raises(InvalidInput) as caught:
        load_region(path)
    message = str(caught.value)
    assert str(path) in message
    assert key in message
    assert expectation in message
    assert "\n" not in message


def test_a_region_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(tmp_path / "large.npz")
    monkeypatch.setattr(regions, "MAX_CELLS", 1000)
    with pytest.raises(InvalidInput, match="at most 1000 cells, got 1200"):
        load_region(path)


def test_a_site_longer_than_messages_can_tell_is_refused(tmp_path: Path) -> None:
    open_cells = np.ones((30, 101), dtype=bool)
    cells = {"he3_ppb": np.full((30, 101), 8.0), "elevation_m": None, "orbital_ppb": None, "traversable": open_cells}
    with pytest.raises(InvalidInput, match=r"expected a site of at most 100 km on a side, got 101 x 30 km"):
        load_region(saved(tmp_path / "long.npz", **cells, resolution_m=1000.0))
    assert load_region(saved(tmp_path / "long.npz", **cells, resolution_m=990.0)).grid.columns == 101


def test_an_elevation_that_no_ground_has_is_refused(tmp_path: Path) -> None:
    peak = np.zeros((30, 40))
    peak[3, 4] = 2e5
    with pytest.raises(InvalidInput, match="key elevation_m: expected -9500 to 11000 m, got 200000 in "):
        load_region(saved(tmp_path / "peak.npz", elevation_m=peak))


def test_a_member_that_is_no_array_is_refused(tmp_path: Path) -> None:
    path = saved(tmp_path / "region.npz", he3_ppb=np.full((30, 40), 7.0))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("traversable.npy", b"no array")
    with pytest.raises(InvalidInput, match="key traversable: expected an array in numpy's format, got other bytes"):
        load_region(path)


def test_an_archive_that_would_unpack_to_too_much_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (30_000, 30_000)})
    nothing, quickly = bytes(8 * 1024 * 1024), {"compression": zipfile.ZIP_DEFLATED, "compresslevel": 1}
    with zipfile.ZipFile(path, "w", **quickly) as archive, archive.open("he3_ppb.npy", "w") as member:
        member.write(header.getvalue())
        for _ in range(MAX_FILE_BYTES // len(nothing)):
            member.write(nothing)
    with pytest.raises(InvalidInput, match="bytes of arrays"):
        load_region(path)


def test_pickled_objects_are_not_opened(tmp_path: Path) -> None:
    path = tmp_path / "objects.npz"
    np.savez(path, he3_ppb=np.array([object()], dtype=object), resolution_m=1.0)
    with pytest.raises(InvalidInput, match=r"objects\.npz: expected an \.npz file of plain numeric arrays"):
        load_region(path)


def packed(path: Path, member: bytes, method: int = zipfile.ZIP_STORED) -> bytearray:
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("he3_ppb.npy", member)
    return bytearray(path.read_bytes())


@pytest.mark.parametrize(
    ("method", "spoil"),
    [
        (zipfile.ZIP_STORED, "unknown method"),
        (zipfile.ZIP_STORED, "encrypted"),
        (zipfile.ZIP_DEFLATED, "damaged"),
        (zipfile.ZIP_BZIP2, "damaged"),
        (zipfile.ZIP_LZMA, "damaged"),
    ],
)
def test_an_archive_that_cannot_be_unpacked_is_refused_in_one_line(tmp_path: Path, method: int, spoil: str) -> None:
    array = io.BytesIO()
    np.save(array, np.random.default_rng(1).uniform(5, 9, (30, 40)))
    path = tmp_path / "packed.npz"
    content = packed(path, array.getvalue(), method)
    entry = content.rindex(b"PK\x01\x02")
    match spoil:
        case "unknown method":
            content[entry + 10] = 99
        case "encrypted":
            content[entry + 8] |= 1
        case _:
            content[60:90] = bytes(range(30))
    path.write_bytes(content)
    with pytest.raises(
        InvalidInput, match=r"packed\.npz: expected an \.npz file of plain numeric arrays, got "
    ) as caught:
        load_region(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "header", [b"{'shape': ((((", b"{'descr': '<f8', 'fortran_order': False, 'shape': (10**9", b"[" * 900]
)
def test_an_array_with_a_header_that_cannot_be_read_is_refused_in_one_line(tmp_path: Path, header: bytes) -> None:
    path = tmp_path / "header.npz"
    packed(path, b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(InvalidInput, match=r"header\.npz: expected an \.npz file") as caught:
        load_region(path)
    assert "\n" not in str(caught.value)


def test_an_array_that_claims_more_cells_than_memory_holds_is_refused_in_one_line(tmp_path: Path) -> None:
    array = io.BytesIO()
    shape = (2**28, 2**28)
    np.lib.format.write_array_header_1_0(array, {"descr": "<f8", "fortran_order": False, "shape": shape})
    path = tmp_path / "claims.npz"
    packed(path, array.getvalue())
    with pytest.raises(InvalidInput, match=r"claims\.npz: expected an \.npz file") as caught:
        load_region(path)
    assert "\n" not in str(caught.value)


def test_what_is_no_archive_no_file_or_no_known_name_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("hello")
    (tmp_path / "folder.npz").mkdir()
    whole = saved(tmp_path / "whole.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    for name in ("text.npz", "folder.npz", "cut.npz", "absent.npz"):
        with pytest.raises(InvalidInput, match=name) as caught:
            load_region(tmp_path / name)
        assert "\n" not in str(caught.value)
    with pytest.raises(InvalidInput, match="t1, t2"):
        load_region("t3")


def test_a_field_seed_with_a_region_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"x\.npz: expected no field seed with a region file, .*; got 7$"):
        load_region(tmp_path / "x.npz", 7)


MARKS = (np.nan, np.inf, -9999.0, -32768.0, 32767.0, 65535.0, -3.4028226550889045e38, 1e20, 9999.0, -999.0)


@pytest.mark.parametrize(
    ("key", "value"),
    [(key, value) for key in ("elevation_m", "orbital_ppb") for value in MARKS]
    + [("he3_ppb", value) for value in MARKS[1:]],
)
def test_a_missing_value_is_not_taken_for_a_value(tmp_path: Path, key: str, value: float) -> None:
    layer = np.random.default_rng(1).uniform(4, 9, (30, 40))
    assert load_region(saved(tmp_path / "whole.npz", **{key: layer.astype(np.float32)}))
    layer[7, 9] = value
    with pytest.raises(InvalidInput, match=f"key {key}: expected .* 1 cell, at row 7, column 9$"):
        load_region(saved(tmp_path / "holed.npz", **{key: layer.astype(np.float32)}))
    layer[20:, 3] = value
    with pytest.raises(InvalidInput, match=f"key {key}: expected .* 11 cells, the first at row 7, column 9$"):
        load_region(saved(tmp_path / "holed.npz", **{key: layer}))


def test_a_cell_without_a_reference_is_known_as_such_closed_and_kept_in_a_copy(tmp_path: Path) -> None:
    he3 = np.random.default_rng(1).uniform(4, 9, (30, 40))
    he3[5:9, 6:10] = np.nan
    region = load_region(saved(tmp_path / "holed.npz", he3_ppb=he3))
    build(str(tmp_path / "holed.npz"), tmp_path / "copy.npz")
    for read in (region, load_region(tmp_path / "copy.npz")):
        assert read.known is not None
        assert np.array_equal(read.known, np.isfinite(he3))
        assert np.array_equal(read.traversable, np.isfinite(he3))
        assert np.array_equal(read.he3_ppb[read.known], he3[read.known])
        assert read.he3_ppb[5, 7] == he3[4, 7]
    assert load_region(saved(tmp_path / "whole.npz")).known is None


def test_what_resampling_leaves_of_a_missing_height_is_refused(tmp_path: Path) -> None:
    elevation = np.random.default_rng(1).normal(-2600.0, 3.0, (30, 40))
    elevation[7, 9] = 0.6 * elevation[7, 9] - 0.4 * 9999.0
    with pytest.raises(InvalidInput, match=r"steps of at most 300 m between cells of 2 m, got higher ones, .* row 7, "):
        load_region(saved(tmp_path / "smeared.npz", elevation_m=elevation))


def test_steep_ground_walls_and_hot_spots_are_values(tmp_path: Path) -> None:
    elevation = np.zeros((30, 40))
    elevation[10:12] = 100.0
    he3 = np.full((30, 40), 8.0)
    he3[3, 3] = 500.0
    region = load_region(saved(tmp_path / "odd.npz", elevation_m=elevation, he3_ppb=he3))
    assert not region.traversable[10].any()
    assert region.he3_ppb.max() == 500.0
    everywhere = load_region(saved(tmp_path / "rich.npz", he3_ppb=np.full((30, 40), 9999.0)))
    assert everywhere.he3_ppb.min() == 9999.0
