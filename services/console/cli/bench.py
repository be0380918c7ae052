"""``he3 bench NAME``: the benchmarks of a checkout, their flags read from what each of them takes."""

from __future__ import annotations

from typing import Annotated

import typer

EXAMPLES = """\b
Examples:
  he3 bench                          which there are
  he3 bench paper --seeds 3 --json paper.json
  he3 bench map --help
"""

CONTEXT = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}


def bench(
    context: typer.Context,
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Which; none lists them.")] = None,
) -> None:
    """Measure: against the paper, against other software, against the machine. Flags go to the benchmark."""
    from services.console.cli.benchmarks import listing, run_benchmark

    if name is None or name in ("-h", "--help"):
        typer.echo(context.get_help() + "\n\n" + "\n".join(listing()))
        return
    run_benchmark(name, context.args, typer.echo)
