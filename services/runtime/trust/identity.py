"""An identity: the folder of a process or a person with certificate and key, read and checked at start."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from he3.errors import InvalidInput
from schemas.roles import Role
from services.runtime.trust.certificates import (
    Subject,
    read_certificate,
    read_key,
    require_issued_by,
    require_valid_at,
    utc_now,
)
from services.runtime.trust.private_files import read_private, require_private_folder
from services.runtime.trust.roster import FILE as ROSTER
from services.runtime.trust.roster import Roster, read_roster

CERTIFICATE, KEY, AUTHORITY = "certificate.pem", "key.pem", "authority.pem"
PAGE_CERTIFICATE, PAGE_KEY, PAGE_AUTHORITY = "page-certificate.pem", "page-key.pem", "page-authority.pem"


@dataclass(frozen=True, slots=True)
class Identity:
    """The identity of this process, with its private key."""

    folder: Path
    subject: Subject
    certificate: x509.Certificate = field(repr=False)
    key: Ed25519PrivateKey = field(repr=False)
    authority: x509.Certificate = field(repr=False)
    roster: Roster = field(repr=False)
    """The roster when the identity was read; `read_roster(roster_path, authority)` reads a newer one."""

    @property
    def role(self) -> Role:
        return self.subject.role

    @property
    def name(self) -> str:
        """Name of the process or person, without its role."""
        return self.subject.name

    @property
    def common_name(self) -> str:
        return self.subject.common_name

    @property
    def expires(self) -> datetime:
        return self.certificate.not_valid_after_utc

    @property
    def certificate_path(self) -> Path:
        return self.folder / CERTIFICATE

    @property
    def key_path(self) -> Path:
        return self.folder / KEY

    @property
    def authority_path(self) -> Path:
        return self.folder / AUTHORITY

    @property
    def roster_path(self) -> Path:
        return self.folder / ROSTER

    def require_role(self, *roles: Role) -> None:
        """Raise InvalidInput unless the identity has one of these roles."""
        if self.role not in roles:
            expected = " or ".join(roles)
            raise InvalidInput(f"{self.folder}: expected an identity of role {expected}, got {self.common_name}")


def load_identity(folder: Path, now: datetime | None = None) -> Identity:
    """The identity of that folder; now: wall time at which it must be valid, else the present.

    Raises InvalidInput, in one line that shows no secret, for a folder that others may enter, a missing or damaged
    file, a key that does not belong to the certificate, and a certificate that is expired, revoked or another
    authority's.
    """
    folder = folder.absolute()
    require_private_folder(folder)
    certificate = read_certificate(read_private(folder / CERTIFICATE), str(folder / CERTIFICATE))
    authority = read_certificate(read_private(folder / AUTHORITY), str(folder / AUTHORITY))
    key = read_key(read_private(folder / KEY), str(folder / KEY))
    who = require_issued_by(certificate, authority, str(folder / CERTIFICATE))
    public = certificate.public_key()
    if (
        not isinstance(key, Ed25519PrivateKey)
        or not isinstance(public, Ed25519PublicKey)
        or key.public_key().public_bytes_raw() != public.public_bytes_raw()
    ):
        raise InvalidInput(f"{folder / KEY}: expected the key of {CERTIFICATE}, got another")
    when = utc_now() if now is None else now
    require_valid_at(certificate, when, f"{folder}: {who.common_name}")
    roster = read_roster(folder / ROSTER, authority)
    for entry in roster.entries:
        if entry.common_name == who.common_name and entry.revoked_at is not None:
            raise InvalidInput(f"{folder}: {who.common_name} was revoked at {entry.revoked_at:%Y-%m-%d %H:%M} UTC")
    return Identity(folder, who, certificate, key, authority, roster)
