"""The roster: every certificate that the mission's authority issued, and which are revoked; signed by the authority.

It holds nothing secret. The routers' access rules and the check of every signature follow from it. A process reads it
from its identity's folder when it starts, and again when the file changes.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Annotated

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from pydantic import BaseModel, ConfigDict, Field

from he3.errors import InvalidInput
from schemas.roles import Role
from services.runtime.trust.certificates import (
    fingerprint,
    parse_common_name,
    read_certificate,
    require_issued_by,
    require_valid_at,
)
from services.runtime.trust.private_files import read_private

FILE = "roster.json"
_PURPOSE = b"he3 roster 1\n"
"""Prefix of the signed bytes, so that no other signature of the authority counts as a roster's."""


class RosterEntry(BaseModel):
    """One identity: its newest certificate, and when it was revoked."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    common_name: Annotated[str, Field(max_length=64)]
    certificate: Annotated[str, Field(max_length=4096)]
    """PEM."""
    revoked_at: datetime | None = None

    @property
    def role(self) -> Role:
        return parse_common_name(self.common_name).role

    @property
    def name(self) -> str:
        return parse_common_name(self.common_name).name

    @cached_property
    def x509(self) -> x509.Certificate:
        return read_certificate(self.certificate.encode(), self.common_name)

    @property
    def expires(self) -> datetime:
        return self.x509.not_valid_after_utc

    @property
    def public_key(self) -> Ed25519PublicKey:
        """The key of this identity's signatures."""
        key = self.x509.public_key()
        if not isinstance(key, Ed25519PublicKey):
            raise InvalidInput(f"{self.common_name}: expected an Ed25519 key, got another kind")
        return key


class RosterDocument(BaseModel):
    """The content of a roster file, without its signature."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    authority: str
    """Fingerprint of the authority's certificate."""
    revision: Annotated[int, Field(ge=1, lt=2**53)]
    """Grows by one with each change."""
    entries: Annotated[tuple[RosterEntry, ...], Field(max_length=2000)] = ()

    def canonical(self) -> bytes:
        """The bytes that are signed."""
        document = self.model_dump(mode="json")
        return _PURPOSE + json.dumps(document, sort_keys=True, separators=(",", ":")).encode()


@dataclass(frozen=True, slots=True)
class Roster:
    """The certificates that this mission trusts."""

    authority: x509.Certificate
    document: RosterDocument
    _by_name: dict[str, RosterEntry] = field(default_factory=dict, repr=False)

    @property
    def entries(self) -> tuple[RosterEntry, ...]:
        return self.document.entries

    def trusted(self, common_name: str, now: datetime) -> RosterEntry:
        """The entry of an identity whose certificate is valid at that wall time.

        Raises InvalidInput, in one line, for one that is not in the roster, that was revoked, or that has expired.
        """
        entry = self._by_name.get(common_name)
        if entry is None:
            raise InvalidInput(f"expected a name of this mission's roster, got '{common_name[:80]}'")
        if entry.revoked_at is not None:
            raise InvalidInput(f"{common_name}: revoked at {entry.revoked_at:%Y-%m-%d %H:%M} UTC")
        require_valid_at(entry.x509, now, common_name)
        return entry

    def allowed(self, role: Role) -> tuple[str, ...]:
        """Common names of that role which are not revoked, in order; an expired one fails at the TLS handshake."""
        return tuple(sorted(each.common_name for each in self.entries if each.role is role and not each.revoked_at))


def make_roster(authority: x509.Certificate, document: RosterDocument) -> Roster:
    """The roster of that document; raises InvalidInput for an entry whose certificate is not of that authority."""
    by_name: dict[str, RosterEntry] = {}
    for entry in document.entries:
        who = require_issued_by(entry.x509, authority, f"roster: {entry.common_name}")
        if who.common_name != entry.common_name or entry.common_name in by_name:
            raise InvalidInput(f"roster: expected one entry for {who.common_name} under its own name")
        by_name[entry.common_name] = entry
    return Roster(authority, document, by_name)


def roster_bytes(document: RosterDocument, key: Ed25519PrivateKey) -> bytes:
    """The content of a roster file, signed by the authority's key."""
    signature = base64.b64encode(key.sign(document.canonical())).decode()
    return json.dumps({"roster": document.model_dump(mode="json"), "signature": signature}, indent=1).encode() + b"\n"


def read_roster(path: Path, authority: x509.Certificate) -> Roster:
    """The roster of that file; raises InvalidInput unless that authority has signed it."""
    content = read_private(path)
    try:
        outer = json.loads(content)
        signature = base64.b64decode(outer["signature"], validate=True)
        document = RosterDocument.model_validate(outer["roster"])
    except (ValueError, TypeError, KeyError, RecursionError):
        raise InvalidInput(f"{path}: expected a signed roster (JSON), got something else") from None
    key = authority.public_key()
    try:
        if not isinstance(key, Ed25519PublicKey) or document.authority != fingerprint(authority):
            raise InvalidSignature
        key.verify(signature, document.canonical())
    except InvalidSignature:
        raise InvalidInput(f"{path}: expected a roster signed by this mission's authority, got another") from None
    return make_roster(authority, document)
