"""The flags that say which running mission a command joins, and as whom."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.console.cli.flag_groups import FlagGroup
from services.console.cli.options import checked

if TYPE_CHECKING:
    from services.console.client.mission_client import MissionClient


def _missions(incomplete: str) -> list[str]:
    """Names of the missions of this machine that begin so, for tab completion."""
    from services.console.client.run_file import running_missions

    return [each.mission for each in running_missions() if each.mission.startswith(incomplete)]


Mission = Annotated[
    str | None,
    typer.Option("--mission", metavar="NAME", help="Name of the running mission.", autocompletion=_missions),
]
Earth = Annotated[
    str | None,
    typer.Option("--earth", metavar="ENDPOINT", help="Endpoint of its Earth router, such as tcp/10.0.0.2:7448."),
]
IdentityFolder = Annotated[
    Path | None,
    typer.Option(
        "--identity", metavar="DIR", help="Folder of your identity, for a mission with keys (or HE3_IDENTITY)."
    ),
]
Insecure = Annotated[
    bool,
    typer.Option("--insecure", help="Allow an endpoint off loopback without TLS: anyone who reaches it may command."),
]


def _person(text: str) -> str:
    from he3.errors import InvalidInput

    if not (0 < len(text) <= 100 and text.isprintable() and text.strip()):
        raise InvalidInput(f"expected a name of 1 to 100 characters on one line, got '{text[:100]}'")
    return text


AsName = Annotated[
    str | None,
    typer.Option(
        "--as", metavar="NAME", help="Your name in a mission without keys, instead of user@host. Nothing proves it.",
        callback=checked(_person),
    ),
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Session(FlagGroup):
    """The running mission that a command joins; without flags, the one of this machine."""

    mission: Mission = None
    earth: Earth = None
    identity: IdentityFolder = None
    insecure: Insecure = False

    def join(self, *, name: str = "operator") -> MissionClient:
        """A client of the mission; `name` is what its process is called there."""
        return self._client(name, None)

    def _client(self, name: str, as_name: str | None) -> MissionClient:
        from services.console.client.mission_client import MissionClient

        return MissionClient(
            self.earth, self.mission, name=name, identity=self.identity, insecure=self.insecure, as_name=as_name
        )


@dataclass(frozen=True, slots=True)
class NamedSession(Session):
    """A session that commands or changes something, under the name of a person or program."""

    as_name: AsName = None

    def join(self, *, name: str = "operator") -> MissionClient:
        """A client of the mission that acts under the given name."""
        return self._client(name, self.as_name)
