"""The recipe of a region: its rasters, place and chemistry. `he3 region template` prints examples.

It is versioned and checked strictly; a refusal is one line with file, key and expectation.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from he3 import constants
from schemas.maps import MAX_CELLS
from schemas.wire import MAX_POSITION_M
from services.mission.region_folder import Latitude, Longitude, Name, Table, Words, checked, load_toml

Layer = Literal["elevation_m", "iron_wt", "maturity", "titanium_wt", "he3_ppb", "rock_abundance"]
Cells = Annotated[int, Field(ge=4, le=4000)]


class GridTable(Table):
    """The place of a raster without georeferencing (.npy): its centre and pixel size; row 0 is north of the centre."""

    centre_lat_deg: Latitude
    centre_lon_deg: Longitude
    resolution_m: Annotated[float, Field(gt=0, le=10_000)]


class SourceTable(Table):
    """The raster of one layer."""

    file: Annotated[Words, Field(min_length=1)]
    """Path, from the recipe's folder; or an address (https://, /vsicurl/...), read by range requests."""
    band: Annotated[str, Field(max_length=200)] | Annotated[int, Field(ge=1, le=10_000)] | None = None
    """Its description in the file, or its number; needed where there are several."""
    scale: float | None = None
    """Value = number * scale + offset; by default those of the file."""
    offset: float | None = None
    unit: Literal["m", "km", "wt%", "fraction", "1", "ppb", "ppm"] | None = None
    """Unit of the values; by default the file's, else the layer's."""
    no_data: Annotated[tuple[float, ...], Field(max_length=16)] = ()
    """Numbers that mark missing values, beside the file's own, NaN, infinity and anything below -1e30."""
    zero_is_missing: bool = False
    fill_holes: bool = False
    """Whether missing values are filled from those around them; the region marks such cells."""
    mask_holes: bool = False
    """Whether nothing is known where values are missing: the field has no reference there, or rocks close nothing."""
    kind: Literal["real", "synthetic", "derived"] = "real"
    source: Annotated[Words, Field(min_length=1)]
    """Short description of the source, for reports."""
    product_id: Words = ""
    citation: Words = ""
    grid: GridTable | None = None


class ChemistryTable(Table):
    """Parameters of the computation of helium-3 from the layers."""

    titanium: Literal["paper", "apollo-17-soils"] = "paper"
    """Relation of TiO2 to FeO without a layer titanium_wt: the paper's, or the fit to Apollo 17 soils alone."""
    assumed_maturity: Annotated[float, Field(ge=constants.OMAT_MIN, le=constants.OMAT_MAX)] | None = None
    """OMAT to assume without a layer maturity."""
    lay_over: Literal["t1", "t2"] | None = None
    """Stand-in whose chemistry is laid over a place that has only terrain."""
    solar_wind_flux: Annotated[float, Field(gt=0, le=1)] | None = None
    """Solar-wind flux relative to normal incidence; by default from latitude and longitude, for the near side."""
    perturbation: Annotated[float, Field(ge=0, le=0.5)] = constants.PERTURBATION
    correlation_length_m: Annotated[float, Field(gt=0, le=10_000)] = constants.CORRELATION_LENGTH_M
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1


class Recipe(Table):
    """The whole document."""

    format: Literal["he3-region-recipe"]
    version: Literal[1]
    name: Name
    title: Annotated[Words, Field(min_length=1, max_length=200)]
    centre_lat_deg: Latitude
    centre_lon_deg: Longitude
    rows: Cells = constants.SITE_CELLS
    columns: Cells = constants.SITE_CELLS
    resolution_m: Annotated[float, Field(ge=0.01, le=1000)] = constants.SITE_RESOLUTION_M
    projection: Annotated[str, Field(max_length=1000)] = ""
    """A PROJ string or a code such as IAU_2015:30135; by default local, see docs/regions.md."""
    slope_limit_deg: Annotated[float, Field(gt=0, le=45)] = constants.ROVER_SLOPE_NOMINAL_DEG
    terrain_rule: Literal["vehicle", "paper"] = "vehicle"
    """By the following limits as well; or by hollows and hummocks, as the paper does."""
    step_limit_m: Annotated[float, Field(gt=0, le=10)] = constants.ROVER_STEP_M
    roughness_limit_m: Annotated[float, Field(gt=0, le=10)] = constants.ROVER_ROUGHNESS_M
    rock_limit: Annotated[float, Field(ge=0, le=1)] = constants.ROVER_ROCK_ABUNDANCE
    """Share of the ground under rocks, where there is a layer rock_abundance."""
    chemistry: ChemistryTable = ChemistryTable()
    layers: Annotated[dict[Layer, SourceTable], Field(min_length=1)]

    @model_validator(mode="after")
    def _can_be_flown_and_has_terrain_and_chemistry(self) -> Recipe:
        layers, chemistry = self.layers, self.chemistry
        if self.rows * self.columns > MAX_CELLS:
            raise ValueError(f"expected at most {MAX_CELLS} cells, got {self.rows} x {self.columns}")
        if max(self.rows, self.columns) * self.resolution_m > MAX_POSITION_M:
            raise ValueError(f"expected a site of at most {MAX_POSITION_M / 1000:g} km on a side, got "
                             f"{max(self.rows, self.columns) * self.resolution_m / 1000:g} km")  # fmt: skip
        if "elevation_m" not in layers:
            raise ValueError("expected a layer elevation_m, got none")
        if layers["elevation_m"].mask_holes:
            raise ValueError("expected heights everywhere, got mask_holes of layer elevation_m; fill_holes fills them")
        for name, table in layers.items():
            if table.mask_holes and table.fill_holes:
                raise ValueError(f"expected fill_holes or mask_holes of layer {name}, got both")
        if "he3_ppb" in layers:
            return self
        measured = "iron_wt" in layers or "titanium_wt" in layers
        if measured == (chemistry.lay_over is not None):
            raise ValueError("expected one of: layer iron_wt or titanium_wt, or chemistry.lay_over")
        if measured and "maturity" not in layers and chemistry.assumed_maturity is None:
            raise ValueError("expected a layer maturity, or chemistry.assumed_maturity where OMAT is not measured")
        return self


def read_recipe(path: Path) -> Recipe:
    """The recipe of a TOML file; raises InvalidInput, in one line with file, key and expectation."""
    return checked(Recipe, load_toml(path), path)
