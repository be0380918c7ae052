"""The ``he3`` command: what commands there are, and what stands in its help."""

from __future__ import annotations

from typing import Annotated

import typer

from services.console.commands import run as run_command

ABOUT = """Helium-3 prospecting on the Moon: a rover, an honest map, and the light time between them.

Start with: he3 demo
"""


def build() -> typer.Typer:
    """The command line application; making it imports nothing heavy."""
    app = typer.Typer(
        name="he3",
        help=ABOUT,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )
    app.callback()(_common)
    app.command("run", epilog=run_command.EXAMPLES)(run_command.run)
    return app


def _common(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    if version:
        from services.presence import software_version

        typer.echo(f"he3-seeker {software_version()}")
        raise typer.Exit
