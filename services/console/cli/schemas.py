"""``he3 schemas``: the messages on the wire as JSON Schema."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXAMPLES = """\b
Examples:
  he3 schemas schemas.json.d/        # one file for each message
  he3 schemas | jq '."tm.sample"'    # all in one document
"""


def schemas(
    folder: Annotated[Path | None, typer.Argument(metavar="DIR", help="Folder for one file a message.")] = None,
) -> None:
    """The JSON Schema of every message on the wire, and of the mission report."""
    import json as json_format

    from schemas.__main__ import json_schemas
    from services.runtime.files.output import failed, write_output

    documents = json_schemas()
    if folder is None:
        typer.echo(json_format.dumps(documents, indent=2))
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, document in documents.items():
            write_output(folder / f"{name}.schema.json", f"{json_format.dumps(document, indent=2)}\n".encode())
    except OSError as error:
        raise failed(f"{folder}: cannot write the schemas", error) from None
    typer.echo(f"written to {folder}: {len(documents)} schemas")
