"""``he3 keys``: a mission's own certificate authority, and an identity for each process and person."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.console.cli.options import AsJson, ScenarioRef, within

if TYPE_CHECKING:
    from datetime import datetime

    from services.runtime.trust.authority import Authority
    from services.runtime.trust.certificates import Subject
    from services.runtime.trust.roster import RosterEntry

EXAMPLES = """\b
Examples:
  he3 keys init keys/                           # an authority, and an identity for each process
  he3 keys issue operator anna --in keys/       # keys/identities/operator-anna, for the operator's machine
  he3 up t1 --keys keys/                        # a mission over TLS with these keys
  he3 command pause --identity keys/identities/operator-anna
  he3 keys list --in keys/                      # all identities and their expiry dates
  he3 keys renew operator anna --in keys/
  he3 keys revoke operator anna --in keys/
  he3 keys zenoh keys/ t1 --out zenoh/          # the rules that both routers apply
"""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

MAX_DAYS = 36_500.0

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The mission's folder of keys.")]
In = Annotated[Path, typer.Option("--in", metavar="DIR", help="The mission's folder of keys.")]
RoleName = Annotated[
    str,
    typer.Argument(
        metavar="ROLE", help="field, rover, link, ground, recorder, viewer (reads), operator (commands) or controller."
    ),
]
PersonName = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the process or person: a-z, 0-9, '-' and '_'.")
]
Days = Annotated[
    float,
    typer.Option("--days", metavar="D", help="Days of validity.", callback=within(0, MAX_DAYS, above=True)),
]
Hosts = Annotated[
    list[str] | None,
    typer.Option("--host", metavar="NAME", help="Host name or address at which this person serves the page (he3 web)."),
]
KEYS = Path("keys")


@app.command(short_help="Make an authority, and an identity for each process.", epilog=EXAMPLES)
def init(
    folder: Folder,
    days: Days = 90.0,
    authority_days: Annotated[
        float,
        typer.Option("--authority-days", metavar="D", help="Validity of the authority [days].",
                     callback=within(0, MAX_DAYS, above=True)),
    ] = 3650.0,
    json: AsJson = False,
) -> None:  # fmt: skip
    """Make a certificate authority, and an identity for each process of a mission."""
    from services.console.launch.keys import issue_for_processes
    from services.runtime.trust.authority import Authority

    authority = Authority.create(folder, timedelta(days=authority_days))
    folders = issue_for_processes(authority, timedelta(days=days))
    typer.echo(_document(authority) if json else "\n".join(map(str, folders)))


@app.command(short_help="Issue an identity for one process or person.", epilog=EXAMPLES)
def issue(
    role: RoleName, name: PersonName, folder: In = KEYS, days: Days = 90.0, host: Hosts = None, json: AsJson = False
) -> None:
    """Issue an identity: a folder with a certificate and its key, for one process or person."""
    authority, who = _about(folder, role, name)
    issued = authority.issue(who, timedelta(days=days), tuple(host or ()))
    typer.echo(_document(authority, who) if json else issued)


@app.command(epilog=EXAMPLES)
def renew(
    role: RoleName, name: PersonName, folder: In = KEYS, days: Days = 90.0, host: Hosts = None, json: AsJson = False
) -> None:
    """Issue a new certificate for the same key. Running processes use it after a restart."""
    authority, who = _about(folder, role, name)
    renewed = authority.renew(who, timedelta(days=days), tuple(host or ()))
    typer.echo(_document(authority, who) if json else renewed)


@app.command(epilog=EXAMPLES)
def revoke(role: RoleName, name: PersonName, folder: In = KEYS, json: AsJson = False) -> None:
    """Take all rights from an identity. The routers refuse it as soon as the link is started with the new roster."""
    authority, who = _about(folder, role, name)
    revoked = authority.revoke(who)
    said = f"{revoked.common_name} is revoked; copy {folder}/roster.json to each identity on other machines"
    typer.echo(_document(authority, who) if json else said)


@app.command("list", epilog=EXAMPLES)
def list_(folder: In = KEYS, json: AsJson = False) -> None:
    """List all identities with their expiry dates and revocations."""
    from services.runtime.trust.authority import Authority

    authority = Authority(folder)
    if json:
        typer.echo(_document(authority))
        return
    for row in _rows(authority):
        typer.echo(f"{row['common_name']:<28} {row['state']:<8} until {row['expires']}")


def _about(folder: Path, role: str, name: str) -> tuple[Authority, Subject]:
    """The authority in that folder, and the subject of the identity that a command is about."""
    from services.runtime.trust.authority import Authority
    from services.runtime.trust.certificates import subject

    return Authority(folder), subject(role, name)


def _document(authority: Authority, who: Subject | None = None) -> str:
    """The identities as JSON text. who: only the newest one of that role and name."""
    import json as json_format

    rows = _rows(authority)
    if who is not None:
        rows = [row for row in rows if (row["role"], row["name"]) == (who.role.value, who.name)][-1:]
    return json_format.dumps(rows, indent=2)


def _rows(authority: Authority) -> list[dict[str, Any]]:
    """All identities in the order in which they were issued."""
    from services.runtime.trust.certificates import utc_now

    now = utc_now()
    return [_row(authority, entry, now) for entry in authority.roster.entries]


def _row(authority: Authority, entry: RosterEntry, now: datetime) -> dict[str, Any]:
    from services.runtime.trust.certificates import Subject

    folder = authority.folder_of(Subject(entry.role, entry.name))
    state = "revoked" if entry.revoked_at is not None else "expired" if now > entry.expires else "valid"
    return {
        "common_name": entry.common_name,
        "role": entry.role.value,
        "name": entry.name,
        "state": state,
        "expires": entry.expires.isoformat(timespec="minutes"),
        "revoked_at": None if entry.revoked_at is None else entry.revoked_at.isoformat(timespec="seconds"),
        "serial": format(entry.x509.serial_number, "x"),
        "folder": str(folder) if folder.is_dir() else None,
    }


@app.command(short_help="Write the access rules of both routers.", epilog=EXAMPLES)
def zenoh(
    folder: Folder,
    scenario: ScenarioRef,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the files.")] = Path("zenoh"),
    json: AsJson = False,
) -> None:
    """Write the access rules of both routers as Zenoh configuration, as the link applies them."""
    import json as json_format

    from services.console.launch.scenarios import choose
    from services.runtime.trust.authority import Authority
    from services.runtime.trust.zenoh_files import write_access_files

    mission = choose(scenario).scenario.name
    files = [str(path) for path in write_access_files(out, mission, Authority(folder).roster)]
    typer.echo(json_format.dumps({"files": files}, indent=2) if json else "\n".join(files))
