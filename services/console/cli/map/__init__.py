"""``he3 map``: the live map at a place, as a picture, as files, as tables, over an area, and as a feed.

One module a topic: `point`, `layer`, `area`, `tables`, `files`, `export`, `feed`, `cross_validation`,
`realisations`, `grade_tonnage`; `answers` prints and draws, `options` describes the flags that they share.
"""

from __future__ import annotations

import typer

from services.console.cli.coordinates import NEGATIVE_NUMBERS
from services.console.cli.map import (
    area,
    cross_validation,
    export,
    feed,
    files,
    grade_tonnage,
    layer,
    point,
    realisations,
    tables,
)

EXAMPLES = """\b
Examples:
  he3 map at 120 340
  he3 map show mean
  he3 map show std --png std.png
  he3 map show exceedance --threshold 10
  he3 map show mean --as-of 12
  he3 map box mean 100 100 200 200 --resolution 5
  he3 map save exceedance rich.tif --threshold 9
  he3 map export maps
  he3 map export belief.npz
  he3 map export maps --recording runs/t1/mission.mcap
  he3 map resource 100,100 200,100 150,200 --cutoff 9
  he3 map grade-tonnage --cutoffs 7,8,9 --png curve.png
  he3 map samples --csv
  he3 map plan
  he3 map history              # the revisions that --as-of can name
  he3 map follow               # a line for each change, until the mission is over
  he3 map score --json
  he3 map cross-validation --png check.png
  he3 map realisations fields.npz --count 200 --png fields.png
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

app.command("at", short_help="The belief at one place.", epilog=EXAMPLES, context_settings=NEGATIVE_NUMBERS)(point.at)
app.command("show", short_help="A whole layer in the terminal.", epilog=EXAMPLES)(layer.show)
app.command("box", short_help="A part of a layer.", epilog=EXAMPLES, context_settings=NEGATIVE_NUMBERS)(layer.box)
app.command("save", short_help="A layer as a file.", epilog=EXAMPLES)(files.save)
app.command("export", short_help="The whole map for QGIS and other tools, in a folder.", epilog=EXAMPLES)(export.export)
app.command(
    "resource", short_help="Helium-3 in an area, with intervals.", epilog=EXAMPLES, context_settings=NEGATIVE_NUMBERS
)(area.resource)
app.command(
    "grade-tonnage",
    short_help="Ground above each cut-off, and what it holds.",
    epilog=EXAMPLES,
    context_settings=NEGATIVE_NUMBERS,
)(grade_tonnage.grade_tonnage)
app.command("samples", short_help="The samples.", epilog=EXAMPLES)(tables.samples)
app.command("plan", short_help="The driven and the planned path.", epilog=EXAMPLES)(tables.plan)
app.command("history", short_help="The earlier maps.", epilog=EXAMPLES)(tables.history)
app.command("score", short_help="Error against the reference field.", epilog=EXAMPLES)(point.score)
app.command(
    "cross-validation",
    short_help="Error without a reference: each sample from the others.",
    epilog=EXAMPLES,
)(cross_validation.cross_validation)
app.command("realisations", short_help="Fields that the samples leave possible, as a file.", epilog=EXAMPLES)(
    realisations.realisations
)
app.command("follow", short_help="The map's feed, a line for each change.", epilog=EXAMPLES)(feed.follow)
