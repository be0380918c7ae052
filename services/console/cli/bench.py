"""``he3 bench NAME``: the benchmarks of a checkout, each a command made from the signature of its ``run`` function."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

EXAMPLES = """\b
Examples:
  he3 bench                          # list the benchmarks
  he3 bench paper --seeds 3 --json paper.json
  he3 bench map --help
"""


class Benchmarks(TyperGroup):
    """The benchmarks as commands. Only the named one is imported; the list is read from their sources."""

    def list_commands(self, ctx: Any) -> list[str]:
        from services.console.cli.benchmarks import described

        return list(described())

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        from services.console.cli.benchmarks import command

        return command(cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        from services.console.cli.benchmarks import described

        with formatter.section("Benchmarks"):
            formatter.write_dl(list(described().items()))

    def invoke(self, ctx: Any) -> Any:
        from services.console.interruption import ending_in_time

        with ending_in_time():
            return super().invoke(ctx)


app = typer.Typer(cls=Benchmarks, invoke_without_command=True, rich_markup_mode=None)


@app.callback(epilog=EXAMPLES)
def bench(context: typer.Context) -> None:
    """Run a benchmark: against the paper, against other software, against the machine."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
