"""Sites that can be fetched, and the public products that cover them: ``sites.toml``, or a file of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from he3.errors import InvalidInput
from services.mission.region_build.recipe import Cells, Layer, Recipe
from services.mission.region_folder import Latitude, Longitude, Name, Table, Words, checked, load_toml

SITES: Final = Path(__file__).with_name("sites.toml")

Address = Annotated[str, Field(pattern=r"^https?://[\x21-\x7e]+$", max_length=1000)]


class Product(Table):
    """A raster that a server offers for range requests."""

    url: Address
    label: Address | None = None
    """Of a PDS3 image; it is fetched as a whole."""
    layer: Layer
    source: Words
    product_id: Words = ""
    citation: Words = ""

    @property
    def file(self) -> str:
        """Name of its file here."""
        return self.url.rsplit("/", 1)[-1]


class SiteTable(Table):
    """A place, and the products that cover it."""

    title: Words
    centre_lat_deg: Latitude
    centre_lon_deg: Longitude
    rows: Cells = 500
    columns: Cells = 500
    resolution_m: Annotated[float, Field(ge=0.01, le=1000)] = 1.0
    products: Annotated[tuple[Name, ...], Field(min_length=1)]
    lay_over: Literal["t1", "t2"] | None = None
    solar_wind_flux: Annotated[float, Field(gt=0, le=1)] | None = None


class SitesDocument(Table):
    """``sites.toml``."""

    products: dict[Name, Product]
    sites: dict[Name, SiteTable]

    @model_validator(mode="after")
    def _products_exist(self) -> SitesDocument:
        for name, site in self.sites.items():
            for product in site.products:
                if product not in self.products:
                    raise ValueError(f"sites.{name}: expected products of this file, got {product!r}")
        return self


@dataclass(frozen=True, slots=True)
class Site:
    """A site to fetch."""

    name: str
    table: SiteTable
    products: tuple[Product, ...]

    def recipe(self) -> Recipe:
        """The recipe of its region, from the files that are fetched."""
        table = self.table
        layers = {
            product.layer: {"file": product.file, "source": product.source, "product_id": product.product_id,
                            "citation": product.citation}
            for product in self.products
        }  # fmt: skip
        chemistry: dict[str, Any] = {"lay_over": table.lay_over, "solar_wind_flux": table.solar_wind_flux}
        document = {
            "format": "he3-region-recipe", "version": 1, "name": self.name, "title": table.title,
            "centre_lat_deg": table.centre_lat_deg, "centre_lon_deg": table.centre_lon_deg, "rows": table.rows,
            "columns": table.columns, "resolution_m": table.resolution_m, "chemistry": chemistry, "layers": layers,
        }  # fmt: skip
        return checked(Recipe, document, Path(f"site {self.name}"))


def site_named(name: str, file: Path | None = None) -> Site:
    """The site of that name in ``sites.toml`` or the file given; raises InvalidInput with the names that exist."""
    path = file or SITES
    document = checked(SitesDocument, load_toml(path), path)
    if name not in document.sites:
        raise InvalidInput(f"expected a site out of {', '.join(document.sites)}, got {name!r}")
    table = document.sites[name]
    return Site(name, table, tuple(document.products[product] for product in table.products))
