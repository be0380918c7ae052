"""Operators' queries of the live map, and the replies. Plain Zenoh clients put the parameters in the selector."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Final, Literal

from pydantic import Field

from schemas.wire import Count, MissionTimeNs, PositionM, Provenance, Text, Wire, is_none

MAX_CELLS: Final = 4_000_000
"""Most cells of a region, and of an answer: 16 MB of float32, a site of 2 km at 1 m."""

Probability = Annotated[float, Field(ge=0, le=1)]
Ppb = Annotated[float, Field(ge=0, le=1e6)]

AsOf = Annotated[str, Field(max_length=40, pattern=r"^(\d{1,19}|\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d(\.\d{1,9})?)?Z?)$")]
"""The map that is meant: a revision, or a mission time as 2030-01-01T06:00:00Z or in nanoseconds since 1970.

The reply is from the last revision that is not later, which it names.
"""

PolygonText = Annotated[str, Field(max_length=10_000, pattern=r"^\s*-?[\d.eE+-]+(\s*,\s*-?[\d.eE+-]+)+\s*$")]
"""Corners of an area as 'x,y,x,y,...' [m]."""


class MapFormat(StrEnum):
    """The format of a reply. All but JSON are the payload itself, with a `MapAbout` as the attachment."""

    JSON = "json"
    NPY = "npy"
    """NumPy's file format, float32 or uint8, row 0 in the south."""
    PNG = "png"
    """A picture, north up."""
    TIFF = "tiff"
    """GeoTIFF, float32 or uint8, north up, in metres of IAU_2015:30110."""
    CSV = "csv"
    PACKED = "packed"
    """16-bit steps between `low` and `high` of the description, compressed: see services/ground/map/packing.py."""


class MapPointQuery(Wire):
    """Query of the belief at one place."""

    x: PositionM
    y: PositionM
    threshold: Ppb | None = None
    """Abundance [ppb] for which the exceedance is asked too."""
    as_of: AsOf | None = None


class MapPoint(Wire):
    """Posterior of the helium-3 abundance at one place, from the map of one revision."""

    x_m: PositionM
    y_m: PositionM
    mean_ppb: float
    std_ppb: Annotated[float, Field(ge=0)]
    traversable: bool
    revision: Count
    """Increases by one with every change of the map."""
    samples: Count
    """Measurements in the map."""
    mission_time_ns: MissionTimeNs
    """Mission time of that revision."""
    information_nats: Annotated[float, Field(ge=0)] | None = None
    """Mutual information between one measurement there and the field."""
    exceedance: Probability | None = None
    """Probability that the abundance exceeds the threshold, if one was given."""
    low_68_ppb: float | None = None
    """Ends of the central interval that holds 68.3 % of the belief, which need not be normal; not below 0."""
    high_68_ppb: float | None = None
    low_95_ppb: float | None = None
    """Ends of the central interval that holds 95.4 %."""
    high_95_ppb: float | None = None


class MapLayer(StrEnum):
    MEAN = "mean"
    STD = "std"
    TRAVERSABLE = "traversable"
    INFORMATION = "information"
    """Mutual information between one measurement at the place and the field [nat]."""
    EXCEEDANCE = "exceedance"
    """Probability that the abundance exceeds `threshold`."""
    ELEVATION = "elevation"
    SLOPE = "slope"
    """Steepest slope at the place [deg]."""
    SHADE = "shade"
    """Brightness of the relief under light from the north-west, 45 degrees high; 1 faces the light."""
    REFERENCE = "reference"
    """Helium-3 of a simulated Moon, which no real mission knows [ppb]."""
    ERROR = "error"
    """Posterior mean less that reference [ppb]."""
    SAMPLES = "samples"
    """A table of the samples and their places."""
    PLAN = "plan"
    """A table of the vertices of the driven and the planned path."""


TABLES: tuple[MapLayer, ...] = (MapLayer.SAMPLES, MapLayer.PLAN)
"""Layers that are lists of places."""
RASTERS: tuple[MapLayer, ...] = tuple(layer for layer in MapLayer if layer not in TABLES)
"""Layers with a value in every cell."""
TERRAIN: tuple[MapLayer, ...] = (MapLayer.ELEVATION, MapLayer.SLOPE, MapLayer.SHADE)
"""Rasters of the region's terrain, which no sample changes."""
SIMULATED: tuple[MapLayer, ...] = (MapLayer.REFERENCE, MapLayer.ERROR)
"""Rasters that exist only where the ground knows the reference field of a simulated Moon."""
BELIEF: tuple[MapLayer, ...] = tuple(layer for layer in RASTERS if layer not in TERRAIN + SIMULATED)
"""Rasters of what the ground believes."""


class MapLayerQuery(Wire):
    """A whole layer, or every `step`-th cell of it from the south-west corner on."""

    layer: MapLayer
    step: Annotated[int, Field(ge=1, le=500)] = 1
    threshold: Ppb | None = None
    """Threshold of the exceedance [ppb]."""
    as_of: AsOf | None = None
    format: MapFormat = MapFormat.JSON


class MapBoxQuery(Wire):
    """A part of a layer, its edges in metres, in cells from its south-west corner on whose centres lie in it."""

    layer: MapLayer
    x_min: PositionM
    y_min: PositionM
    x_max: PositionM
    y_max: PositionM
    resolution_m: Annotated[float, Field(gt=0, le=1e5)] | None = None
    """Side of a cell of the answer, whose value is the map's at its centre; None: the map's own."""
    threshold: Ppb | None = None
    as_of: AsOf | None = None
    format: MapFormat = MapFormat.JSON


class MapRaster(Wire):
    """A layer as base64 of little-endian values, row 0 in the south, [row, column] = [y, x]."""

    layer: MapLayer
    rows: Annotated[int, Field(ge=1, le=MAX_CELLS)]
    columns: Annotated[int, Field(ge=1, le=MAX_CELLS)]
    resolution_m: Annotated[float, Field(gt=0)]
    dtype: Literal["<f4", "|u1"]
    data_base64: Annotated[str, Field(max_length=24_000_000)]
    unit: Text
    revision: Count
    samples: Count
    mission_time_ns: MissionTimeNs
    x_min_m: float = 0.0
    """West edge of the first column; its cells' centres lie half a cell further east."""
    y_min_m: float = 0.0
    """South edge of the first row."""
    threshold_ppb: float | None = None


class MapAbout(Wire):
    """Description of a picture or an array: the attachment of replies that are not JSON."""

    layer: MapLayer
    format: MapFormat
    rows: Count
    columns: Count
    resolution_m: float
    x_min_m: float
    y_min_m: float
    unit: Text
    low: float
    high: float
    """Smallest and largest value."""
    revision: Count
    samples: Count
    mission_time_ns: MissionTimeNs
    threshold_ppb: float | None = None


class ReachScore(Wire):
    """The belief compared with the reference field over the ground that the rover can reach from its start."""

    share: Annotated[float, Field(gt=0, le=1)]
    """Of the cells that are compared."""
    rmse_ppb: Annotated[float, Field(ge=0)]
    coverage_68: Annotated[float, Field(ge=0, le=1)]
    coverage_95: Annotated[float, Field(ge=0, le=1)]


class MapScore(Wire):
    """The belief compared with the reference field over all cells, which only a simulated Moon provides."""

    rmse_ppb: Annotated[float, Field(ge=0)]
    coverage_68: Annotated[float, Field(ge=0, le=1)]
    """Share of the cells whose central interval of 68.3 % holds the truth; of a normal belief, mean +- 1 std."""
    coverage_95: Annotated[float, Field(ge=0, le=1)]
    """Share of the cells whose central interval of 95.4 % holds the truth; of a normal belief, mean +- 2 std."""
    mean_std_ppb: Annotated[float, Field(ge=0)]
    revision: Count
    samples: Count
    mission_time_ns: MissionTimeNs
    within_reach: ReachScore | None = Field(default=None, exclude_if=is_none)
    """The same over the ground within reach; None where that is every cell, or none."""


class Interval(Wire):
    """Expectation and credible interval."""

    expected: float
    low: float
    high: float


class RealisationsQuery(Wire):
    """Query of fields drawn from the joint posterior of the whole site."""

    count: Annotated[int, Field(ge=1, le=1000)] = 100
    as_of: AsOf | None = None


class MapRealisations(Wire):
    """Fields drawn from the joint posterior: little-endian float32 in base64, [realisation, row, column], row 0 south.

    A value is that of the place at a cell's centre, in ppb, not below zero, without measurement noise.
    """

    count: Count
    rows: Count
    columns: Count
    resolution_m: Annotated[float, Field(gt=0)]
    """Side of a cell: the map's, or a multiple of it where the map has more than 2,500 cells."""
    data_base64: Annotated[str, Field(max_length=24_000_000)]
    revision: Count
    samples: Count
    mission_time_ns: MissionTimeNs


class CrossValidationQuery(Wire):
    """Query of each sample as the others predict it."""

    as_of: AsOf | None = None


class PredictedSample(Wire):
    """A sample as all the others predict it."""

    sample_id: Text
    x_m: PositionM
    y_m: PositionM
    measured_ppb: float
    expected_ppb: float
    """Mean of the prediction."""
    std_ppb: Annotated[float, Field(ge=0)]
    """Standard deviation of the prediction, measurement noise included."""
    score: float
    """Where the measured value lies in the prediction, in standard deviations of a normal distribution; 6 at most."""


class CrossValidationFigures(Wire):
    """The belief judged by its samples, each predicted from all others: for a Moon without a reference field."""

    rmse_ppb: Annotated[float, Field(ge=0)]
    """Root mean square of measured less expected value."""
    bias_ppb: float
    """Mean of measured less expected value."""
    score_rms: Annotated[float, Field(ge=0)]
    """Root mean square of the scores: 1 if the belief is honest, more if it is too certain."""
    within_68: Probability
    """Share of the samples within the map's intervals of 68.3 %."""
    within_95: Probability
    """Share of the samples within the map's intervals of 95.4 %."""


class CrossValidation(CrossValidationFigures):
    """The figures, and each sample with its prediction."""

    samples: tuple[PredictedSample, ...]
    """In the order in which they arrived."""
    revision: Count
    mission_time_ns: MissionTimeNs


CutoffsText = Annotated[str, Field(max_length=1000)]
"""Up to 40 abundances as 'a,b,...' [ppb]."""


class GradeTonnageQuery(Wire):
    """Query of how much ground lies above each of several cut-offs, and what it holds; the site without a polygon."""

    polygon: PolygonText | None = None
    cutoffs: CutoffsText | None = None
    """None: even steps over the values that the field may have."""
    probability: Annotated[float, Field(gt=0, lt=1)] = 0.9
    """Probability of the credible intervals."""
    as_of: AsOf | None = None


class GradeTonnagePoint(Wire):
    """The ground above one cut-off."""

    cutoff_ppb: float
    area_m2: Interval
    mean_ppb: Interval | None
    """Mean abundance of that ground, in the fields that have some; None if no drawn field has any."""
    mass_kg_per_m: Interval
    """Helium-3 in that ground per metre of depth."""


class GradeTonnage(Wire):
    """A grade-tonnage curve with credible intervals, from fields drawn from the joint posterior.

    The abundance is that of places, not a mean over what a machine would mine at once: with mining in larger units less
    ground lies above a high cut-off.
    """

    area_m2: Annotated[float, Field(ge=0)]
    """The whole area."""
    curve: tuple[GradeTonnagePoint, ...]
    """By rising cut-off."""
    bulk_density_kg_m3: float
    probability: float
    draws: Count
    block_m: float
    """Side of the blocks of cells for each of which one place is drawn [m]."""
    revision: Count
    samples: Count
    mission_time_ns: MissionTimeNs


class MapTrackQuery(Wire):
    """Query of samples and paths, present or past."""

    as_of: AsOf | None = None


class MapRevision(Wire):
    """A revision of the map that is kept."""

    revision: Count
    samples: Count
    mission_time_ns: MissionTimeNs
    mean_std_ppb: Annotated[float, Field(ge=0)]


class MapSite(Wire):
    """The grid and the place of the map."""

    rows: Count
    columns: Count
    resolution_m: float
    origin_lat_deg: float | None
    """Latitude and longitude of the south-west corner; None if the region has no coordinates on the Moon."""
    origin_lon_deg: float | None
    noise_std_ppb: float
    """Standard deviation of a measurement in the belief."""
    provenance: Provenance = ""
    """Of the region's data."""


class RegionLayer(Wire):
    """Where one layer of the region comes from. Texts are empty where nothing is known."""

    layer: Text
    kind: Text
    """real, derived, assumed or synthetic."""
    source: Provenance
    file: Provenance = ""
    sha256: Text = ""
    window: Provenance = ""
    product_id: Provenance = ""
    citation: Provenance = ""


class MapRegion(Wire):
    """The region under the map: its name, its place on the Moon, and where its layers come from."""

    name: Text
    title: Text
    location: Annotated[str, Field(max_length=4096)]
    """Name of an embedded region, or the path of a region's folder or file on the ground's machine."""
    field_seed: Annotated[int, Field(ge=0, lt=2**63)] | None
    """Seed of the variation of a region that has several; None: the region's own."""
    provenance: Provenance
    rows: Count
    columns: Count
    resolution_m: float
    origin_lat_deg: float | None
    """Latitude and longitude of the south-west corner; None if the region has no coordinates on the Moon."""
    origin_lon_deg: float | None
    crs: Annotated[str, Field(max_length=4096)]
    """Projection of the site's plane as a PROJ string; empty if the region does not give one."""
    origin_x_m: float | None
    """Of the south-west corner in that projection [m]."""
    origin_y_m: float | None
    layers: tuple[RegionLayer, ...]
    file_sha256: Annotated[str, Field(max_length=64)] = ""
    """SHA-256 of a region that is one file; empty for a folder, whose layers have theirs."""


class MapHistory(Wire):
    """The site and the revisions that are kept, oldest first; the last is the present map."""

    site: MapSite
    revisions: tuple[MapRevision, ...]


class ResourceQuery(Wire):
    """Query of the helium-3 in an area; without a polygon, in the whole site."""

    polygon: PolygonText | None = None
    cutoff_ppb: Ppb = 8.0
    """Abundance above which ground counts as ore."""
    probability: Annotated[float, Field(gt=0, lt=1)] = 0.9
    """Probability of the credible intervals, and of a cell that counts as confidently above the cut-off."""
    as_of: AsOf | None = None


class ResourceEstimate(Wire):
    """Helium-3 in an area, a metre deep, with intervals from the joint posterior of all its cells."""

    area_m2: Annotated[float, Field(ge=0)]
    cells: Count
    mean_ppb: Interval
    """Mean abundance over the area."""
    mean_std_ppb: float
    """Standard deviation of that mean."""
    mass_kg_per_m: Interval
    """Helium-3 per metre of depth at `bulk_density_kg_m3`, with an abundance independent of depth."""
    bulk_density_kg_m3: float
    cutoff_ppb: float
    area_above_m2: Interval
    """Area above the cut-off."""
    confident_area_m2: float
    """Area of the cells that are each above the cut-off with at least `probability`."""
    probability: float
    quadrature_m: float
    """Spacing of the places over which the correlation with the samples was integrated [m]."""
    quadrature_error_ppb: float
    """Change of the mean's standard deviation when that spacing is doubled [ppb]."""
    revision: Count
    samples: Count
    mission_time_ns: MissionTimeNs


class FrameKind(StrEnum):
    KEY = "key"
    """The whole map."""
    DELTA = "delta"
    """The difference from the frame before."""
    BEAT = "beat"
    """No values: the present sequence, sent periodically, so that a reader notices a missed frame."""


class MapFrame(Wire):
    """The head of a frame of the map's feed; values follow it, see services/ground/map/feed.py."""

    kind: FrameKind
    epoch: Count
    """Identifies the start of the feed; frames of different epochs cannot be combined."""
    sequence: Count
    """Increases by one with every change of the feed; a delta applies to the frame with one less."""
    rows: Count
    columns: Count
    resolution_m: float
    revision: Count
    samples: Count
    mission_time_ns: MissionTimeNs
    checksum: Annotated[int, Field(ge=0, lt=2**32)]
    """CRC-32 of mean, std (little-endian float32) and traversable (bytes), after this frame; 0 in a beat."""
