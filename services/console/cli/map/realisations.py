"""``he3 map realisations``: fields that the samples leave possible, as a file."""

from __future__ import annotations

import io
import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.flag_groups import with_flags
from services.console.cli.map.files import written
from services.console.cli.map.options import AsOf
from services.console.cli.options import AsJson, within
from services.console.cli.session import Session
from services.console.client.words import counted

if TYPE_CHECKING:
    from services.console.client.map_queries import Realisations

FORMS = (".npz", ".csv")


@with_flags
def realisations(
    session: Session,
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help=".npz (x_m, y_m, he3_ppb), or .csv (a row a place, a column a field)."),
    ],
    count: Annotated[
        int, typer.Option("--count", metavar="N", help="Realisations (1 to 1000).", callback=within(1, 1000))
    ] = 100,
    png: Annotated[
        Path | None, typer.Option("--png", metavar="PICTURE", help="Write a picture of five of them, too.")
    ] = None,
    as_of: AsOf = None,
    json: AsJson = False,
) -> None:  # fmt: skip
    """Fields drawn from the belief (conditional simulation), for all that depends on more than one place.

    Each one agrees with the samples as closely as their noise allows, and is as rough between them as the field is. The
    map's mean is smoother than any of them. On sites of more than 2,500 cells the cells of a realisation are larger
    than the map's. The same revision has the same realisations.
    """
    import numpy as np

    from he3.errors import InvalidInput

    if file.suffix.lower() not in FORMS:
        raise InvalidInput(f"{file}: expected a file name with {' or '.join(FORMS)}; got '{file.suffix}'")
    with session.join() as client:
        found = client.realisations(count, as_of)
        mean = None if png is None else client.layer("mean", as_of=found.revision)
        samples = None if png is None else client.samples(found.revision)
    line = written(file, table_of(found).encode() if file.suffix.lower() == ".csv" else arrays_of(found))
    if png is not None and mean is not None and samples is not None:
        from services.console.report.pictures import save
        from services.console.report.realisations_picture import realisations_figure

        places = np.column_stack((samples.x_m, samples.y_m))
        save(realisations_figure(found.values, mean.values, mean.extent, places, described(found)), png)
    if json:
        rows, columns = found.values.shape[1:]
        document = {
            "written": str(file), "count": count, "rows": rows, "columns": columns, "resolution_m": found.resolution_m,
            "revision": found.revision, "samples": found.samples, "picture": None if png is None else str(png),
        }  # fmt: skip
        typer.echo(json_format.dumps(document, indent=2))
        return
    typer.echo(line)
    typer.echo(described(found))
    if png is not None:
        typer.echo(f"written to {png}")


def described(found: Realisations) -> str:
    """What the file has, in one line."""
    count, rows, columns = found.values.shape
    return (
        f"{count} realisations of {rows} x {columns} cells of {found.resolution_m:g} m, revision {found.revision}, "
        f"{counted(found.samples, 'sample')}"
    )


def arrays_of(found: Realisations) -> bytes:
    """The bytes of an .npz with x_m (columns,), y_m (rows,) and he3_ppb (count, rows, columns), row 0 south."""
    import numpy as np

    stream = io.BytesIO()
    np.savez_compressed(stream, x_m=found.x_m, y_m=found.y_m, he3_ppb=found.values)
    return stream.getvalue()


def table_of(found: Realisations) -> str:
    """A line a cell from the south-west corner on: x_m, y_m, and its value in each realisation [ppb]."""
    import numpy as np

    count = len(found.values)
    x, y = np.meshgrid(found.x_m, found.y_m)
    columns = np.column_stack((x.ravel(), y.ravel(), found.values.reshape(count, -1).T))
    head = ",".join(("x_m", "y_m", *(f"r{number + 1}" for number in range(count))))
    stream = io.StringIO()
    np.savetxt(stream, columns, fmt="%.6g", delimiter=",", header=head, comments="")
    return stream.getvalue()
