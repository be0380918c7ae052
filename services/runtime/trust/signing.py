"""Signatures of messages: made with the key of an identity, verified against the roster. Pure: no clock, no files.

What counts is the signature of an identity of this mission's roster, for this topic, this mission and this run of it,
of a role that may do what the message does. A refusal is one line that names the sender as far as it is proven.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Final, Protocol

from cryptography.exceptions import InvalidSignature

from he3.errors import InvalidInput
from schemas.codec import NotPermitted
from schemas.commands import Authorization, Telecommand
from schemas.signing import Part, signed_bytes
from schemas.topics import COMMAND, ISSUE_COMMAND
from schemas.wire import Header
from services.runtime.trust.certificates import Subject, parse_common_name

if TYPE_CHECKING:
    from schemas.roles import Role
    from services.runtime.trust.roster import Roster

SECOND: Final = 1_000_000_000
MAX_AHEAD: Final = 86_400 * SECOND
"""How far ahead of now a message may be made [ns]: clocks of two machines differ, by more at a higher rate."""
REQUEST_VALID_NS: Final = 30 * 86_400 * SECOND
"""Mission time for which a signed request counts. It is long, as an hour of mission time may pass in milliseconds; the
receiver also remembers the requests that have come."""


class Key(Protocol):
    """A private key: signs bytes."""

    def sign(self, data: bytes) -> bytes: ...


@dataclass(frozen=True, slots=True)
class Signer:
    """Signs what one identity sends in one run of a mission."""

    common_name: str
    key: Key
    instance: str

    def signed(self, part: Part, topic: str, header: Header, body: bytes) -> Header:
        """The header, signed for that topic and body."""
        unsigned = header.model_copy(update={"instance": self.instance, "signer": self.common_name})
        signature = self.key.sign(signed_bytes(part, topic, unsigned, body)).hex()
        return unsigned.model_copy(update={"signature": signature})

    def authorized(self, command: Telecommand, mission: str, made_at: int, expires_at: int) -> Telecommand:
        """The command with the consent of this identity, which counts until that mission time [ns]."""
        order = command.order
        header = _authorization_header(mission, self.instance, self.common_name, made_at, expires_at)
        text = signed_bytes(Part.AUTHORIZATION, COMMAND.name, header, order.model_dump_json().encode())
        consent = Authorization(
            signer=self.common_name,
            instance=self.instance,
            made_at=made_at,
            expires_at=expires_at,
            signature=self.key.sign(text).hex(),
        )
        return order.model_copy(update={"authorization": consent})


@dataclass(frozen=True, slots=True)
class Verifier:
    """Verifies what arrives in one run of a mission."""

    roster: Callable[[], Roster]
    """The newest roster."""
    mission: str
    instance: str
    wall_time: Callable[[], datetime]
    """The time of this machine, for the validity of certificates."""

    def verify(self, part: Part, topic: str, header: Header, body: bytes, roles: tuple[Role, ...], now: int) -> Subject:
        """Who made this message; raises Refused unless the signature is right and the signer has one of the roles.

        body: as it was received. now: mission time [ns].
        """
        what = f"{topic} of {header.source}"
        if header.signer is None or header.signature is None:
            raise NotPermitted(f"{what}: expected a signature of role {' or '.join(roles)}, got none")
        text = signed_bytes(part, topic, header, body)
        who = self._signed_by(header.signer, header.signature, text, topic)
        what = f"{topic} of {_shown(who)}"
        self._require_this_run(what, header.mission, header.instance)
        _require_role(what, who, roles)
        if header.source not in (who.role.value, who.common_name):
            raise NotPermitted(f"{what}: expected source '{who.role.value}', got '{header.source}'")
        _require_in_time(what, header.made_at, header.expires_at, now)
        return who

    def verify_command(self, command: Telecommand, now: int) -> Subject:
        """Who issued this command; raises Refused unless a person has authorized exactly it, who may command."""
        what = f"command {command.command_id}"
        consent = command.authorization
        roles = ISSUE_COMMAND.access.query
        if consent is None:
            raise NotPermitted(f"{what}: expected the signature of role {' or '.join(roles)}, got none")
        header = _authorization_header(
            self.mission, consent.instance, consent.signer, consent.made_at, consent.expires_at
        )
        text = signed_bytes(Part.AUTHORIZATION, COMMAND.name, header, command.order.model_dump_json().encode())
        who = self._signed_by(consent.signer, consent.signature, text, what)
        what = f"{what} of {_shown(who)}"
        self._require_this_run(what, self.mission, consent.instance)
        _require_role(what, who, roles)
        if command.issued_by is not None:
            raise NotPermitted(f"{what}: expected no other name beside the signature, got one")
        _require_in_time(what, consent.made_at, consent.expires_at, now)
        return who

    def _signed_by(self, signer: str, signature: str, text: bytes, what: str) -> Subject:
        """The subject of the signer; raises Refused unless the signature is theirs and they are trusted now."""
        try:
            entry = self.roster().trusted(signer, self.wall_time())
            entry.public_key.verify(bytes.fromhex(signature), text)
        except InvalidInput as error:
            raise NotPermitted(f"{what}: {error}") from None
        except (InvalidSignature, ValueError):
            raise NotPermitted(
                f"{what}: expected the signature of {signer} over this very message, got another: altered, or forged"
            ) from None
        return parse_common_name(signer)

    def _require_this_run(self, what: str, mission: str, instance: str | None) -> None:
        if (mission, instance) != (self.mission, self.instance):
            raise NotPermitted(
                f"{what}: expected mission '{self.mission}', run {self.instance}, "
                f"got mission '{mission}', run {instance}"
            )


def _authorization_header(mission: str, instance: str, signer: str, made_at: int, expires_at: int) -> Header:
    return Header(
        mission=mission,
        source=signer,
        incarnation=0,
        sequence=0,
        made_at=made_at,
        instance=instance,
        expires_at=expires_at,
        signer=signer,
    )


def _require_role(what: str, who: Subject, roles: tuple[Role, ...]) -> None:
    if who.role not in roles:
        raise NotPermitted(f"{what}: expected role {' or '.join(roles)}")


def _require_in_time(what: str, made_at: int, expires_at: int | None, now: int) -> None:
    if made_at > now + MAX_AHEAD:
        raise NotPermitted(f"{what}: expected one made by now, got one {(made_at - now) / SECOND:g} s ahead")
    if expires_at is not None and now > expires_at:
        raise NotPermitted(f"{what}: expired {(now - expires_at) / SECOND:g} s ago: late, or replayed")


def _shown(who: Subject) -> str:
    """The role and the name, and the generation from the second on: viewer anna."""
    return f"{who.role.value} {who.name}" + (f" ({who.generation})" if who.generation > 1 else "")
