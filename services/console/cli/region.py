"""``he3 region``: show regions as figures and pictures, build them from rasters of orbital products, fetch rasters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.options import MAX_SEED, AsJson, within

if TYPE_CHECKING:
    from he3.reference import Region

EXAMPLES = """\b
Examples:
  he3 region show t1
  he3 region show t2 --png t2.png
  he3 region template dem > place.toml
  he3 region build place.toml --out place
  he3 region fetch herodotus --out data
  he3 region build t1 --field-seed 7 --out t1-seed7.npz
  he3 run my.toml --in-process --set region=place
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

RegionName = Annotated[str, typer.Argument(metavar="REGION", help="t1, t2, a region's folder or an .npz file.")]
FieldSeed = Annotated[
    int | None,
    typer.Option("--field-seed", metavar="N", help="Seed (0 or more) of another variation of t1 or t2.",
                 callback=within(0, MAX_SEED)),
]  # fmt: skip


@app.command("show", short_help="Describe a region.", epilog=EXAMPLES)
def show(
    region: RegionName,
    field_seed: FieldSeed = None,
    png: Annotated[Path | None, typer.Option("--png", metavar="FILE", help="Write a picture as well.")] = None,
    json: AsJson = False,
) -> None:
    """Describe a region: size, helium-3, slopes, ground that is not traversable, and the source of its data."""
    import json as json_format

    loaded = _loaded(region, field_seed)
    figures = _figures(loaded)
    if png is not None:
        from services.console.report.pictures import region_figure, save

        save(region_figure(loaded), png)
    if json:
        typer.echo(json_format.dumps(figures, indent=2))
        return
    size = f"{loaded.grid.columns} x {loaded.grid.rows} cells of {loaded.grid.resolution_m:g} m"
    typer.echo(f"region        {loaded.title}")
    typer.echo(f"data          {loaded.provenance}")
    for origin in loaded.layers:
        typer.echo(f"              {origin.line()}")
    if loaded.origin_lat_deg is not None and loaded.origin_lon_deg is not None:
        typer.echo(f"origin        {loaded.origin_lat_deg:.6f} N {loaded.origin_lon_deg:.6f} E, south-west corner")
    elif loaded.crs and loaded.origin_x_m is not None and loaded.origin_y_m is not None:
        typer.echo(
            f"origin        {loaded.origin_x_m:.1f} m, {loaded.origin_y_m:.1f} m, south-west corner in {loaded.crs}"
        )
    typer.echo(f"size          {size}")
    typer.echo(
        f"helium-3      {figures['he3_min_ppb']:.2f} to {figures['he3_max_ppb']:.2f} ppb, "
        f"mean {figures['he3_mean_ppb']:.2f}, std {figures['he3_std_ppb']:.2f}"
    )
    if figures["relief_m"] is not None:
        typer.echo(f"elevation     {figures['relief_m']:.1f} m from lowest to highest")
        typer.echo(
            f"slope         median {figures['slope_median_deg']:.1f} deg, maximum {figures['slope_max_deg']:.1f} deg"
        )
    else:
        typer.echo("elevation     none is given")
    typer.echo(f"closed        {figures['untraversable_fraction']:.2%} of the ground is not traversable")
    if loaded.known is not None:
        typer.echo(f"unknown       {figures['unknown_fraction']:.2%} of it has no reference, is closed and not scored")
    if png is not None:
        typer.echo(f"written       {png}")


def _loaded(region: str, field_seed: int | None) -> Region:
    """The region; raises InvalidInput for a field seed with a region file, which has one variation only."""
    from he3.errors import InvalidInput
    from services.mission.embedded_regions import EMBEDDED
    from services.mission.regions import load_region

    if field_seed is not None and region not in EMBEDDED and region.endswith(".npz"):
        raise InvalidInput(
            f"--field-seed: expected it with {' or '.join(EMBEDDED)}, got it with {region}, a file of one variation"
        )
    return load_region(region, field_seed)


def _figures(region: Region) -> dict[str, Any]:
    from dataclasses import asdict

    import numpy as np

    field = region.of_known(region.he3_ppb)
    terrain = bool(region.elevation_m.any())  # without heights they are 0 everywhere
    return {
        "name": region.name,
        "title": region.title,
        "provenance": region.provenance,
        "layers": [asdict(origin) for origin in region.layers],
        "origin_lat_deg": region.origin_lat_deg,
        "origin_lon_deg": region.origin_lon_deg,
        "crs": region.crs,
        "origin_x_m": region.origin_x_m,
        "origin_y_m": region.origin_y_m,
        "rows": region.grid.rows,
        "columns": region.grid.columns,
        "resolution_m": region.grid.resolution_m,
        "field_seed": region.seed,
        "he3_min_ppb": float(field.min()),
        "he3_max_ppb": float(field.max()),
        "he3_mean_ppb": float(field.mean()),
        "he3_std_ppb": float(field.std()),
        "relief_m": float(np.ptp(region.elevation_m)) if terrain else None,
        "slope_median_deg": float(np.median(region.slope_deg)) if terrain else None,
        "slope_max_deg": float(region.slope_deg.max()) if terrain else None,
        "untraversable_fraction": region.untraversable_fraction,
        "unknown_fraction": 0.0 if region.known is None else float(1.0 - region.known.mean()),
    }


@app.command("build", short_help="Build a region from rasters, or write one as .npz.", epilog=EXAMPLES)
def build(
    source: Annotated[
        str, typer.Argument(metavar="SOURCE", help="A recipe (.toml), or a region to write as an .npz file.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="PATH",
            help="Folder for the region of a recipe (default: its name); or a file that ends in .npz.",
        ),
    ] = None,
    field_seed: FieldSeed = None,
    json: AsJson = False,
) -> None:
    """Build a region from rasters: a folder with region.toml and GeoTIFFs. Or write a region as an .npz file."""
    from he3.errors import InvalidInput

    if source.endswith(".toml") and Path(source).name != "region.toml":
        if field_seed is not None:
            raise InvalidInput("--field-seed: expected it with a region, got it with a recipe, which has its own seed")
        _build_folder(Path(source), out, json=json)
        return
    if out is None:
        raise InvalidInput("expected --out FILE.npz for a region, got none")
    _build_file(source, out, field_seed, json=json)


def _print_written(where: Path, region: Region) -> None:
    """Print what `he3 region show --json` says of the region, and where it was written."""
    import json as json_format

    typer.echo(json_format.dumps({"written": str(where), **_figures(region)}, indent=2))


def _build_folder(source: Path, out: Path | None, *, json: bool) -> None:
    from services.mission.region_build.build import build_region
    from services.mission.region_build.recipe import read_recipe

    recipe = read_recipe(source)
    folder = out if out is not None else Path(recipe.name)
    document = build_region(recipe, source.parent, folder, _progress)
    if json:
        _print_written(folder, _loaded(str(folder), None))
        return
    typer.echo(f"written to {folder}: {document.title}")
    for origin in document.origins:
        typer.echo(f"              {origin.line()}")


def _progress(line: str) -> None:
    typer.echo(line, err=True)


def _build_file(region: str, out: Path, field_seed: int | None, *, json: bool) -> None:
    import numpy as np

    from he3.errors import InvalidInput
    from services.mission.regions import MAX_PROVENANCE
    from services.runtime.files.output import failed, open_output

    if out.suffix != ".npz":
        raise InvalidInput(f"--out {out}: expected a file name that ends in .npz")
    if not out.parent.is_dir():
        raise InvalidInput(f"--out {out}: expected a folder at {out.parent}, got none")
    loaded = _loaded(region, field_seed)
    degrees = {"origin_lat_deg": loaded.origin_lat_deg, "origin_lon_deg": loaded.origin_lon_deg}
    origin: dict[str, Any] = {key: np.float64(value) for key, value in degrees.items() if value is not None}
    try:
        with open_output(out) as stream:
            np.savez_compressed(
                stream,
                he3_ppb=loaded.he3_ppb if loaded.known is None else np.where(loaded.known, loaded.he3_ppb, np.nan),
                orbital_ppb=loaded.orbital_ppb,
                elevation_m=loaded.elevation_m,
                traversable=loaded.traversable,
                resolution_m=np.float64(loaded.grid.resolution_m),
                provenance=np.str_(loaded.provenance[:MAX_PROVENANCE]),
                **origin,
            )
    except OSError as error:
        raise failed(f"{out}: cannot write the region", error) from None
    if json:
        _print_written(out, loaded)
        return
    typer.echo(f"written to {out}: {loaded.title}, {loaded.grid.rows} x {loaded.grid.columns} cells")


@app.command("template", epilog=EXAMPLES)
def template(
    kind: Annotated[str, typer.Argument(metavar="KIND", help="dem, kaguya, sldem, polar, npy or multiband.")] = "dem",
) -> None:
    """Print an example recipe for one kind of source."""
    from he3.errors import InvalidInput
    from services.mission.region_build.templates import TEMPLATES

    if kind not in TEMPLATES:
        raise InvalidInput(f"expected a template out of {', '.join(TEMPLATES)}, got {kind!r}")
    typer.echo(TEMPLATES[kind], nl=False)


@app.command("fetch", short_help="Download public products of a site and build its region.", epilog=EXAMPLES)
def fetch(
    site: Annotated[
        str, typer.Argument(metavar="SITE", help="t1, t2, apollo-17, herodotus, mare-tranquillitatis, south-pole, ...")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the products and the region.")],
    sites: Annotated[
        Path | None, typer.Option("--sites", metavar="FILE", help="A file of other sites and addresses, as sites.toml.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Download the windows of public products at a site, and build its region. Continues a download broken off."""
    from services.mission.region_build.fetching import fetch_site
    from services.mission.region_build.sites import site_named

    document = fetch_site(site_named(site, sites), out, _progress)
    if json:
        _print_written(out, _loaded(str(out), None))
        return
    typer.echo(f"written to {out}: {document.title}")
