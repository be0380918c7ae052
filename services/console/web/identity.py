"""The page's TLS files, and the login of people by their certificates."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from he3.errors import InvalidInput
from schemas.roles import PERSON_ROLES
from services.console.web.access import Caller, Certified
from services.runtime.trust.certificates import parse_common_name, utc_now
from services.runtime.trust.identity import PAGE_AUTHORITY, PAGE_CERTIFICATE, PAGE_KEY
from services.runtime.trust.private_files import read_private
from services.runtime.trust.roster import Roster, read_roster

if TYPE_CHECKING:
    from services.runtime.trust.identity import Identity


@dataclass(frozen=True, slots=True)
class Tls:
    """Files with which the page is served."""

    certificate: Path
    key: Path
    authority: Path | None = None
    """Authority for the certificates of people; None: no certificate is accepted."""

    def options(self) -> dict[str, Any]:
        """The files as options of uvicorn; raises InvalidInput for invalid files and for files that others may read."""
        read_private(self.key)
        trial = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            # An encrypted key has to be refused, not to ask at a terminal.
            trial.load_cert_chain(self.certificate, self.key, password=lambda: "")
        except (OSError, ssl.SSLError, ValueError) as error:
            system = error.strerror if isinstance(error, OSError) and not isinstance(error, ssl.SSLError) else None
            why = system or "they do not belong together, or the key has a password"
            raise InvalidInput(f"{self.certificate}, {self.key}: expected a certificate and its key: {why}") from None
        files = {"ssl_certfile": str(self.certificate), "ssl_keyfile": str(self.key)}
        if self.authority is None:
            return files
        return {**files, "ssl_ca_certs": str(self.authority), "ssl_cert_reqs": ssl.CERT_OPTIONAL}


def tls_of(identity: Identity) -> Tls:
    """The page's files in the folder of a person's identity; raises InvalidInput for another role's."""
    identity.require_role(*PERSON_ROLES)
    folder = identity.folder
    return Tls(folder / PAGE_CERTIFICATE, folder / PAGE_KEY, folder / PAGE_AUTHORITY)


def certified_by(identity: Identity) -> Certified:
    """The function that finds the caller of a certificate in the newest roster of that identity's folder."""

    known: tuple[int, Roster] = (-1, identity.roster)

    def certified(common_name: str) -> Caller:
        nonlocal known
        subject = parse_common_name(common_name)
        if subject.role not in PERSON_ROLES:
            raise InvalidInput(f"expected a certificate of a person, got one of '{common_name[:80]}'")
        try:
            changed_at = identity.roster_path.stat().st_mtime_ns
        except OSError as error:
            raise InvalidInput(f"{identity.roster_path}: cannot read: {error.strerror}") from None
        if changed_at != known[0]:
            found = read_roster(identity.roster_path, identity.authority)
            # An older one, as from a backup, would let in who was revoked since.
            known = changed_at, max(found, known[1], key=lambda each: each.document.revision)
        known[1].trusted(common_name, utc_now())
        return Caller(common_name, frozenset({subject.role}))

    return certified
