"""``he3 campaign``: thousands of missions from one study, and the report on them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.options import AsJson, Quiet, within

if TYPE_CHECKING:
    from services.console.campaign.runner import Progress

EXAMPLES = """\b
Examples:
  he3 campaign run studies/link.toml                        # on every processor of this host
  he3 campaign run studies/link.toml                        # again: continues where it was ended
  he3 campaign run studies/link.toml --engine dask:tcp://10.0.0.2:8786
  he3 campaign report studies/link.sqlite --out link.html
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

SHOWN = ("rmse_ppb", "path_length_m", "mission_time_s")
"""Figures whose running means are shown."""
PLAIN_EVERY_S = 10.0

StudyFile = Annotated[Path, typer.Argument(metavar="STUDY.toml", help="The study: docs/campaigns.md has its keys.")]


@app.command("run", short_help="Fly the missions of a study, or the rest of them.", epilog=EXAMPLES)
def run(
    study: StudyFile,
    engine: Annotated[
        str,
        typer.Option(
            "--engine",
            metavar="ENGINE",
            help="local, dask (a cluster on this host), or dask:ADDRESS, such as dask:tcp://10.0.0.2:8786.",
        ),
    ] = "local",
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", metavar="N", help="Missions at once; else one for each processor.", callback=within(1, 4096)
        ),
    ] = None,
    store: Annotated[
        Path | None, typer.Option("--store", metavar="FILE", help="The store; else STUDY.sqlite beside the study.")
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Fly those again whose row is an error.")
    ] = False,
    allow_plugin: Annotated[
        bool, typer.Option("--allow-plugin", help="Run the code of planners module:function that the files name.")
    ] = False,
    json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Fly the missions of a study that have no row in its store yet.

    Ctrl-C keeps the rows, and the same command continues.
    """
    import json as json_format

    from he3.errors import He3Error
    from services.console.campaign.engines import engine_named
    from services.console.campaign.runner import run as compute
    from services.console.campaign.store import Store
    from services.console.campaign.study import load_study
    from services.console.campaign.table import kind_of
    from services.console.client.time_format import duration
    from services.console.interruption import ending_in_time

    chosen = load_study(study, allow_plugin)
    tasks = list(chosen.tasks())
    path = study.with_suffix(".sqlite") if store is None else store
    with ending_in_time(), Store(path, write=True) as rows, engine_named(engine, workers) as at_work:
        if not quiet:
            typer.echo(f"{len(tasks)} missions on {at_work.about}", err=True)
        rows.describe(study=chosen.name, description=chosen.description, software=tasks[0].software)
        done = compute(tasks, rows, at_work, _shown(quiet), retry_failed=retry_failed)
    failed = done.failed + done.failed_before
    if json:
        typer.echo(json_format.dumps(_document(chosen.name, path, done), indent=2))
    else:
        flown = done.done + done.failed
        typer.echo(f"study        {chosen.name}")
        typer.echo(f"missions     {done.total} in the store, {done.kept} of them before, {failed} failed")
        if flown:
            typer.echo(
                f"flown        {flown} in {duration(done.elapsed_s)}, {done.computed_s / flown:.2f} s each, "
                f"{done.workers} at once, {done.busy:.0%} of their time at work"
            )
            typer.echo(
                f"on average   {', '.join(kind_of(name).words(mean) for name, mean in done.means(SHOWN).items())}"
            )
        typer.echo(f"store        {path}")
    if failed:
        raise He3Error(
            f"{failed} of {done.total} missions failed"
            + (f", the last: {done.last_error}" if done.last_error else "")
            + "; --retry-failed flies them again"
        )


def _document(study: str, path: Path, done: Progress) -> dict[str, Any]:
    return {
        "study": study,
        "store": str(path),
        "missions": done.total,
        "kept": done.kept,
        "flown": done.done + done.failed,
        "failed": done.failed + done.failed_before,
        "wall_time_s": done.elapsed_s,
        "computed_s": done.computed_s,
        "workers": done.workers,
        "means": done.means(sorted(done.sums)),
    }


def _shown(quiet: bool) -> Callable[[Progress], None]:
    """A function that shows the progress: one line that changes on a terminal, a line every ten seconds elsewhere."""
    import time

    terminal = sys.stderr.isatty()
    shown_at = time.monotonic()

    def show(progress: Progress) -> None:
        nonlocal shown_at
        now = time.monotonic()
        if quiet or (not terminal and now - shown_at < PLAIN_EVERY_S):
            return
        shown_at = now
        line = progress.line(SHOWN)
        typer.echo(f"\r\x1b[K{line}" if terminal else line, nl=not terminal or progress.left == 0, err=True)

    return show


@app.command("report", short_help="Distributions, comparisons, what explains the spread.", epilog=EXAMPLES)
def report(
    store: Annotated[Path, typer.Argument(metavar="STORE", help="The store that 'he3 campaign run' wrote.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Write one HTML page that needs no other file.")
    ] = None,
    csv: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the rows as CSV.")] = None,
    parquet: Annotated[
        Path | None, typer.Option("--parquet", metavar="FILE", help="Write the rows as Parquet.")
    ] = None,
    compare: Annotated[
        str | None,
        typer.Option("--compare", metavar="NAME", help="Compare the values of this parameter, such as planner."),
    ] = None,
    figures: Annotated[
        str | None,
        typer.Option("--figures", metavar="NAMES", help="Report on these figures, such as rmse_ppb,mission_time_s."),
    ] = None,
    json: AsJson = False,
) -> None:
    """Report on the rows of a store, also while a campaign still writes it."""
    import json as json_format

    from schemas.wire import printable
    from services.console.campaign.findings import findings_of
    from services.console.campaign.store import Store
    from services.console.campaign.table import shown_figures, table_of, write_csv, write_parquet
    from services.runtime.files.output import failed, write_output

    with Store(store, write=False) as rows:
        name, about = rows.about("study") or store.stem, rows.about("description")
        facts = [("software", rows.about("software")), ("store", str(store))]
        if others := rows.others:
            facts.append(("left out", f"{others} rows of the study as it was before, or of other software"))
        table = table_of(rows.rows())
    wanted = [] if figures is None else [word for word in figures.split(",") if word]
    found = findings_of(table, shown_figures(table, wanted), compare)
    if csv is not None:
        write_csv(table, csv)
    if parquet is not None:
        write_parquet(table, parquet)
    if out is not None:
        from services.console.campaign.page import page_of

        try:
            write_output(out, page_of(found, name, about, facts).encode())
        except OSError as error:
            raise failed(f"{out}: cannot write the page", error) from None
    if json:
        typer.echo(json_format.dumps({"study": name, **dict(facts), **found.document()}, indent=2))
        return
    from services.console.campaign.summary import summary_lines

    # Another person may have written the store: its texts must not steer the terminal.
    typer.echo("\n".join(map(printable, summary_lines(name, found))))
    for path in (out, csv, parquet):
        if path is not None:
            typer.echo(f"written      {path}")
