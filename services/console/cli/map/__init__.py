"""``he3 map``: the live map at a place, as a picture, as files, as tables, over an area, and as a feed.

One module a topic: `point`, `layer`, `area`, `tables`, `files`, `feed`; `options` describes the flags that they share.
"""

from __future__ import annotations

import typer

from services.console.cli.coordinates import NEGATIVE_NUMBERS
from services.console.cli.map import area, feed, files, layer, point, tables

EXAMPLES = """\b
Examples:
  he3 map at 120 340
  he3 map show mean
  he3 map show std --png std.png
  he3 map show exceedance --threshold 10
  he3 map show mean --as-of 12
  he3 map box mean 100 100 200 200 --resolution 5
  he3 map save exceedance rich.tif --threshold 9
  he3 map export belief.npz
  he3 map resource 100,100 200,100 150,200 --cutoff 9
  he3 map samples --csv
  he3 map score --json
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

app.command("at", epilog=EXAMPLES, context_settings=NEGATIVE_NUMBERS)(point.at)
app.command("show", epilog=EXAMPLES)(layer.show)
app.command("box", epilog=EXAMPLES, context_settings=NEGATIVE_NUMBERS)(layer.box)
app.command("save", epilog=EXAMPLES)(files.save)
app.command("export", epilog=EXAMPLES)(files.export)
app.command("resource", epilog=EXAMPLES, context_settings=NEGATIVE_NUMBERS)(area.resource)
app.command("samples", epilog=EXAMPLES)(tables.samples)
app.command("plan", epilog=EXAMPLES)(tables.plan)
app.command("history", epilog=EXAMPLES)(tables.history)
app.command("score", epilog=EXAMPLES)(point.score)
app.command("follow", epilog=EXAMPLES)(feed.follow)
