"""A telecommand on its way, followed through its stages."""

from __future__ import annotations

import time

from he3.errors import PeerUnreachable
from schemas.commands import CommandList, CommandStage, CommandStatus, NoParameters
from schemas.topics import LIST_COMMANDS
from services.runtime.transport.client import Client


class CommandHandle:
    """A telecommand on its way."""

    def __init__(self, client: Client, status: CommandStatus) -> None:
        self._client = client
        self.status = status

    @property
    def command_id(self) -> str:
        return self.status.command.command_id

    @property
    def stages(self) -> tuple[CommandStage, ...]:
        """The stages passed so far, as last heard."""
        return tuple(report.stage for report in self.status.stages)

    def wait(self, stage: CommandStage | str = CommandStage.COMPLETED, timeout_s: float = 60.0) -> CommandStatus:
        """The status once the command has reached that stage or a later one, or has ended; see `CommandStatus.end`.

        timeout_s: wall time. Raises PeerUnreachable when it runs out.
        """
        wanted = CommandStage(stage)
        deadline = time.monotonic() + timeout_s
        while not self.status.has_reached(wanted):
            left = deadline - time.monotonic()
            if left <= 0:
                raise PeerUnreachable(
                    f"command {self.command_id}: not {wanted.value} within {timeout_s:g} s; "
                    f"it is {self.stages[-1].value if self.stages else 'nowhere'} so far"
                )
            time.sleep(min(0.1, left))
            listed: CommandList = self._client.query(LIST_COMMANDS, NoParameters())
            for status in listed.commands:
                if status.command.command_id == self.command_id:
                    self.status = status
        return self.status
