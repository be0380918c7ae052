"""Windows of products fetched from a local server with range requests: whole, slow, broken and resumed ones."""

from __future__ import annotations

import json
import re
import threading
import time
import urllib.error
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from he3.errors import He3Error
from services.mission.region_build.download import RemoteFile, joined, without
from services.mission.region_build.fetching import fetch_site
from services.mission.region_build.sites import SITES, Site, site_named
from services.mission.regions import load_region

rasterio = pytest.importorskip("rasterio")
pytest.importorskip("pyproj")

LAT, LON = 20.19, 30.772
MOON = "+proj=longlat +R=1737400 +no_defs"


@dataclass
class Server:
    """A file server, and how it misbehaves."""

    folder: Path
    url: str = ""
    sent: int = 0
    """Bytes of bodies, in all."""
    cut_after: int | None = None
    """Bytes of a body after which the connection breaks."""
    gone_after: int | None = None
    """Bytes in all after which every reply is an error."""
    piece: int = 1 << 20
    pause_s: float = 0.0
    ranges: bool = True
    etag: str = '"one"'
    requests: list[str] = field(default_factory=list)

    def reply(self, handler: BaseHTTPRequestHandler) -> None:
        path = self.folder / handler.path.lstrip("/")
        if not path.is_file():
            handler.send_error(404)
            return
        if self.gone_after is not None and self.sent >= self.gone_after:
            handler.send_error(503)
            return
        size = path.stat().st_size
        first, end = 0, size
        asked = re.fullmatch(r"bytes=(\d+)-(\d+)", handler.headers.get("Range", ""))
        if asked and self.ranges:
            first, end = int(asked[1]), min(int(asked[2]) + 1, size)
            handler.send_response(206)
            handler.send_header("Content-Range", f"bytes {first}-{end - 1}/{size}")
        else:
            handler.send_response(200)
        handler.send_header("Content-Length", str(end - first))
        handler.send_header("ETag", self.etag)
        handler.end_headers()
        self.requests.append(f"{handler.path} {first}-{end}")
        with path.open("rb") as stream:
            stream.seek(first)
            body = stream.read(end - first)
        allowed = len(body) if self.cut_after is None else min(len(body), self.cut_after)
        for at in range(0, allowed, self.piece):
            data = body[at : min(at + self.piece, allowed)]
            handler.wfile.write(data)
            self.sent += len(data)
            time.sleep(self.pause_s)
        if allowed < len(body):
            handler.close_connection = True


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    served = Server(tmp_path / "served")
    served.folder.mkdir()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            served.reply(self)

        def log_message(self, format: str, *args: Any) -> None:
            """Nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as http:
        served.url = f"http://127.0.0.1:{http.server_address[1]}"
        thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield served
        http.shutdown()
        thread.join()


def product(folder: Path, name: str, low: float, high: float, **options: Any) -> None:
    """A mosaic of 1024 x 1024 pixels of 1/512 deg around the site, 4 MB, of which the site needs little."""
    random = np.random.default_rng(5)
    values = np.linspace(low, high, 1024)[:, None] + 0.01 * random.standard_normal((1024, 1024))
    transform = rasterio.Affine(1 / 512, 0, round(LON * 512 - 500.3) / 512, 0, -1 / 512, round(LAT * 512 + 480.2) / 512)
    with rasterio.open(
        folder / name, "w", driver="GTiff", height=1024, width=1024, count=1, dtype="float32",
        crs=rasterio.crs.CRS.from_string(MOON), transform=transform, nodata=-3.4028226550889045e38, **options,
    ) as target:  # fmt: skip
        target.write(values.astype("float32"), 1)


def image(folder: Path) -> None:
    """An SLDEM2015 tile in small: an image of kilometres with its label."""
    north, west = round(LAT * 512 + 480.2) / 512, round(LON * 512 - 500.3) / 512
    values = np.linspace(-2.6, -2.5, 1024)[:, None] + np.zeros((1, 1024))
    (folder / "dem.img").write_bytes(bytes(4096) + values.astype("<f4").tobytes())
    (folder / "dem.lbl").write_text(
        f"""PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = 4096
FILE_RECORDS = 1025
^IMAGE = ("dem.img", 2)
OBJECT = IMAGE
  LINES = 1024
  LINE_SAMPLES = 1024
  SAMPLE_TYPE = PC_REAL
  SAMPLE_BITS = 32
  UNIT = KILOMETER
END_OBJECT = IMAGE
OBJECT = IMAGE_MAP_PROJECTION
  MAP_PROJECTION_TYPE = "SIMPLE CYLINDRICAL"
  MAP_RESOLUTION = 512 <pix/deg>
  A_AXIS_RADIUS = 1737.4 <km>
  B_AXIS_RADIUS = 1737.4 <km>
  C_AXIS_RADIUS = 1737.4 <km>
  POSITIVE_LONGITUDE_DIRECTION = "EAST"
  CENTER_LATITUDE = 0 <deg>
  CENTER_LONGITUDE = 0 <deg>
  MAP_SCALE = 0.0592252937999 <km/pix>
  LINE_PROJECTION_OFFSET = {north * 512 - 0.5!r} <pix>
  SAMPLE_PROJECTION_OFFSET = {-west * 512 - 0.5!r} <pix>
END_OBJECT = IMAGE_MAP_PROJECTION
END
"""
    )


@pytest.fixture
def site(server: Server, tmp_path: Path) -> Site:
    product(server.folder, "feo.tif", 15.0, 17.0)
    product(server.folder, "omat.tif", 0.18, 0.22, tiled=True, compress="deflate")
    image(server.folder)
    layers = (("feo.tif", "iron_wt", ""), ("omat.tif", "maturity", ""), ("dem.img", "elevation_m", "dem.lbl"))
    lines = [
        f'[products.{layer}]\nurl = "{server.url}/{file}"\nlayer = "{layer}"\nsource = "served"\n'
        + (f'label = "{server.url}/{label}"\n' if label else "")
        for file, layer, label in layers
    ]
    lines.append(
        f'[sites.here]\ntitle = "Here"\ncentre_lat_deg = {LAT}\ncentre_lon_deg = {LON}\nrows = 50\ncolumns = 50\n'
        'resolution_m = 10.0\nproducts = ["iron_wt", "maturity", "elevation_m"]\nsolar_wind_flux = 0.5\n'
    )
    (tmp_path / "sites.toml").write_text("\n".join(lines))
    return site_named("here", tmp_path / "sites.toml")


def test_a_site_is_fetched_by_ranges_and_its_region_is_that_of_the_whole_files(
    server: Server, site: Site, tmp_path: Path
) -> None:
    fetch_site(site, tmp_path / "out")
    whole = sum(path.stat().st_size for path in server.folder.iterdir())
    assert server.sent < whole / 4
    fetched = load_region(tmp_path / "out")
    recipe = site.recipe()
    from services.mission.region_build.build import build_region

    build_region(recipe, server.folder, tmp_path / "whole")
    again = load_region(tmp_path / "whole")
    for layer in ("he3_ppb", "elevation_m", "traversable"):
        assert np.array_equal(getattr(fetched, layer), getattr(again, layer))
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert {entry["etag"] for entry in manifest.values()} == {'"one"'}
    assert all(re.fullmatch("[0-9a-f]{64}", entry["sha256_of_ranges"]) for entry in manifest.values())


def test_what_has_arrived_is_not_fetched_again(server: Server, site: Site, tmp_path: Path) -> None:
    server.gone_after = 250_000
    with pytest.raises(He3Error, match=r"cannot fetch: HTTP 503 .*; what has arrived is kept") as caught:
        fetch_site(site, tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out" / "region.toml").exists()
    server.gone_after = None
    fetch_site(site, tmp_path / "out")
    broken_off = server.sent
    fetch_site(site, tmp_path / "out")
    assert server.sent == broken_off  # all of it is here
    fresh = tmp_path / "fresh"
    fetch_site(site, fresh)
    assert broken_off == server.sent - broken_off


def test_what_has_been_damaged_here_is_fetched_anew(server: Server, site: Site, tmp_path: Path) -> None:
    """A file whose bytes are no longer those that the manifest has the checksum of; the others are not fetched."""
    fetch_site(site, tmp_path / "out")
    whole, whole_sent = load_region(tmp_path / "out"), server.sent
    first, end = json.loads((tmp_path / "out" / "manifest.json").read_text())[f"{server.url}/feo.tif"]["ranges"][-1]
    with (tmp_path / "out" / "feo.tif").open("r+b") as stream:
        stream.seek((first + end) // 2)
        stream.write(b"\0" * 400)
    said: list[str] = []
    fetch_site(site, tmp_path / "out", said.append)
    assert "feo.tif: other bytes than manifest.json says, fetched anew" in said
    assert 0 < server.sent - whole_sent < whole_sent
    assert np.array_equal(load_region(tmp_path / "out").he3_ppb, whole.he3_ppb)


def test_a_slow_server_that_breaks_every_connection_is_read_to_the_end(
    server: Server, site: Site, tmp_path: Path
) -> None:
    server.cut_after, server.piece, server.pause_s = 40_000, 10_000, 0.001
    said: list[str] = []
    fetch_site(site, tmp_path / "out", said.append)
    assert load_region(tmp_path / "out").he3_ppb.min() > 1.62
    assert any(line.startswith("fetching feo.tif") for line in said)


def test_a_file_that_has_changed_on_the_server_is_fetched_anew(server: Server, tmp_path: Path) -> None:
    (server.folder / "a").write_bytes(b"1" * 1000)
    RemoteFile(f"{server.url}/a", tmp_path / "a").need([(0, 500)])
    (server.folder / "a").write_bytes(b"2" * 1000)
    server.etag = '"two"'
    with pytest.raises(He3Error, match="the file has changed on the server; run the command again"):
        RemoteFile(f"{server.url}/a", tmp_path / "a").need([(500, 1000)])
    assert RemoteFile(f"{server.url}/a", tmp_path / "a").read(0, 1000) == b"2" * 1000


def test_a_server_without_ranges_without_the_file_or_out_of_reach_is_one_line(server: Server, tmp_path: Path) -> None:
    (server.folder / "a").write_bytes(b"1" * 1000)
    server.ranges = False
    with pytest.raises(He3Error, match=r"expected a reply to a range request \(206\), got 200"):
        RemoteFile(f"{server.url}/a", tmp_path / "a").read(0, 10)
    with pytest.raises(He3Error, match="cannot fetch: HTTP 404"):
        RemoteFile(f"{server.url}/none", tmp_path / "none").read(0, 10)
    with pytest.raises(He3Error, match="cannot fetch: Connection refused; what has arrived is kept"):
        RemoteFile("http://127.0.0.1:9/a", tmp_path / "b").read(0, 10)
    assert not (tmp_path / "b").exists()


def test_a_site_of_which_nothing_arrives_leaves_no_folder(server: Server, site: Site, tmp_path: Path) -> None:
    server.gone_after = 0
    with pytest.raises(He3Error, match="cannot fetch: HTTP 503"):
        fetch_site(site, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("code", [404, 503])
def test_an_error_of_the_server_leaves_no_connection_open(code: int, server: Server, tmp_path: Path) -> None:
    (server.folder / "a").write_bytes(b"1" * 1000)
    server.gone_after = 0
    name = {404: "none", 503: "a"}[code]
    with pytest.raises(He3Error, match=f"cannot fetch: HTTP {code}") as caught:
        RemoteFile(f"{server.url}/{name}", tmp_path / name).read(0, 10)
    reply = caught.value.__context__
    assert isinstance(reply, urllib.error.HTTPError)
    assert reply.fp is None or reply.fp.closed


def test_ranges_are_joined_and_subtracted() -> None:
    assert joined([(5, 9), (0, 3), (3, 4), (8, 12)], 0) == [(0, 4), (5, 12)]
    assert joined([(0, 3), (5, 9)], 2) == [(0, 9)]
    assert without((0, 20), [(2, 5), (10, 30)]) == [(0, 2), (5, 10)]
    assert without((2, 5), [(0, 9)]) == []


@pytest.mark.parametrize("name", ["t1", "t2", "apollo-17", "herodotus", "mare-tranquillitatis", "south-pole"])
def test_every_site_has_a_valid_recipe_over_products_with_addresses(name: str) -> None:
    found = site_named(name)
    assert set(found.recipe().layers) == {product.layer for product in found.products}
    assert all(product.url.startswith("https://") for product in found.products)


def test_the_file_of_sites_says_that_nothing_of_it_was_reached() -> None:
    assert "could be reached" in SITES.read_text().splitlines()[1]
