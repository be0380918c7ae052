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
  he3 campaign run studies/link.toml                        on every processor of this host
  he3 campaign run studies/link.toml                        again: continues where it was ended
  he3 campaign run studies/link.toml --engine dask:tcp://10.0.0.2:8786
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
        for name, mean in done.means(SHOWN).items():
            typer.echo(f"{name:<12} {mean:.4f} on average")
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
