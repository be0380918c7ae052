"""``he3 audit``: check and show the audit log of a mission."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.options import AsJson

if TYPE_CHECKING:
    from collections.abc import Callable

    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

EXAMPLES = """\b
Examples:
  he3 audit verify runs/a/audit/ground.jsonl                 # is its chain whole?
  he3 audit verify runs/a/audit/ground.jsonl --keys keys/    # who has signed its lines?
  he3 audit verify runs/a/audit/ground.jsonl --head 3fa1c09e # does it still end as it did?
  he3 audit show runs/a/audit/ground.jsonl
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

File = Annotated[Path, typer.Argument(metavar="FILE", help="An audit log (JSON lines).")]


@app.command("verify", epilog=EXAMPLES)
def verify_(
    file: File,
    keys: Annotated[
        Path | None,
        typer.Option("--keys", metavar="DIR", help="The mission's folder of keys: check the signature of each line."),
    ] = None,
    head: Annotated[
        str | None,
        typer.Option("--head", metavar="HASH", help="Hash of the last line, noted earlier; its start will do."),
    ] = None,
    json: AsJson = False,
) -> None:
    """Check that no line is altered or missing. Without --head a tail that was cut off cannot be seen."""
    import json as json_format

    from he3.errors import InvalidInput
    from services.runtime.trust.audit import file_lines, verify

    verdict = verify(file_lines(file), None if keys is None else _keys_of(keys))
    fault = verdict.fault
    if fault is None and verdict.lines == 0:
        fault = "expected at least the line with which every audit log begins, got none"
    if fault is None and head is not None and not (len(head) >= 8 and verdict.head.startswith(head.lower())):
        fault = f"it ends with {verdict.head}, not with {head[:64]}: its end is missing, or it has grown"
    if json:
        row = {
            "file": str(file),
            "whole": fault is None,
            "fault": fault,
            "lines": verdict.lines,
            "signed": verdict.signed,
            "signers": verdict.signers,
            "torn": verdict.torn,
            "head": verdict.head,
        }
        typer.echo(json_format.dumps(row, indent=2))
    elif fault is None:
        torn = "".join(f"; line {each} was torn by an end of the process" for each in verdict.torn)
        signed = "" if keys is None else f", all signed by {' and '.join(verdict.signers)}"
        typer.echo(f"{file}: whole: {verdict.lines} lines{signed}{torn}")
        typer.echo(f"head {verdict.head}")
    if fault is not None:
        raise InvalidInput(f"{file}: {fault}")


@app.command("show", epilog=EXAMPLES)
def show(file: File, json: AsJson = False) -> None:
    """Show who did what. The lines are not checked; 'verify' does that."""
    import json as json_format

    from services.runtime.trust.audit import file_lines, rows

    found = list(rows(file_lines(file)))
    if json:
        typer.echo(json_format.dumps(found, indent=2))
        return
    for row in found:
        typer.echo(_shown(row))


def _shown(row: dict[str, Any]) -> str:
    from schemas.wire import printable

    about = [str(row[key]) for key in ("what", "why") if row.get(key)]
    if row.get("missed"):
        about.append(f"{row['missed']} lines before this one could not be written")
    by = str(row.get("by") or "-")
    if row.get("verified") is False:
        by += " (unverified)"
    return printable(f"{str(row.get('written_at', ''))[:23]}  {row['kind']:<10}{by:<28} {': '.join(about)}".rstrip())


def _keys_of(folder: Path) -> Callable[[str], Ed25519PublicKey | None]:
    """The keys of the roster of that folder; of revoked and expired identities too, as they signed in their time."""
    from services.runtime.trust.authority import Authority

    found = {entry.common_name: entry.public_key for entry in Authority(folder).roster.entries}
    return found.get
