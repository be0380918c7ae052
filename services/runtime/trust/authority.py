"""A mission's certificate authority: it issues, renews and revokes identities in one folder of keys.

The package's docstring has the layout of the folder. Each change rewrites the roster, in the folder and in every
identity below it; copies on other machines are replaced by hand (docs/lock-down.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from he3.errors import InvalidInput, NotFound
from schemas.roles import PERSON_ROLES
from services.runtime.files.lock import lock_beside
from services.runtime.trust.certificates import (
    Subject,
    certificate_pem,
    fingerprint,
    identity_certificate,
    key_pem,
    new_identity_key,
    new_page_key,
    page_certificate,
    parse_common_name,
    read_certificate,
    read_key,
    require_valid_at,
    self_signed,
    utc_now,
)
from services.runtime.trust.identity import AUTHORITY, CERTIFICATE, KEY, PAGE_AUTHORITY, PAGE_CERTIFICATE, PAGE_KEY
from services.runtime.trust.private_files import make_private_folder, read_private, require_private_folder
from services.runtime.trust.private_files import write_private as write
from services.runtime.trust.roster import FILE as ROSTER
from services.runtime.trust.roster import Roster, RosterDocument, RosterEntry, read_roster, roster_bytes

AUTHORITY_VALID_FOR = timedelta(days=3650)
IDENTITY_VALID_FOR = timedelta(days=90)
"""Validity of an identity; longer missions renew it."""

Clock = Callable[[], datetime]


class Authority:
    """The authority of one mission. Its methods change the folder, one at a time."""

    def __init__(self, folder: Path, clock: Clock = utc_now) -> None:
        """Raises InvalidInput, in one line, for a folder that is no folder of keys.

        clock: wall time, for validity.
        """
        self.folder = folder
        self._clock = clock
        require_private_folder(folder)
        place = folder / "authority"
        self.certificate = read_certificate(read_private(place / CERTIFICATE), str(place / CERTIFICATE))
        self._page_pem = read_private(place / PAGE_CERTIFICATE)

    @classmethod
    def create(cls, folder: Path, valid_for: timedelta = AUTHORITY_VALID_FOR, clock: Clock = utc_now) -> Authority:
        """A new authority in that folder; raises InvalidInput, and changes nothing, if there is one."""
        if (folder / "authority").exists() or (folder / ROSTER).exists():
            raise InvalidInput(f"{folder}: expected a new folder, got one that has an authority")
        make_private_folder(folder)
        place = make_private_folder(folder / "authority")
        now = clock()
        key, page_key = new_identity_key(), new_page_key()
        certificate = self_signed("he3 mission authority", key, now, valid_for)
        page = self_signed("he3 page authority", page_key, now, valid_for)
        write(place / KEY, key_pem(key))
        write(place / PAGE_KEY, key_pem(page_key))
        write(place / CERTIFICATE, certificate_pem(certificate))
        write(place / PAGE_CERTIFICATE, certificate_pem(page))
        document = RosterDocument(authority=fingerprint(certificate), revision=1)
        write(folder / ROSTER, roster_bytes(document, key))
        return cls(folder, clock)

    # --- what it can be asked -----------------------------------------------------------------------------------

    @property
    def roster(self) -> Roster:
        """The present roster: every certificate that was issued."""
        return read_roster(self.folder / ROSTER, self.certificate)

    def folder_of(self, who: Subject) -> Path:
        """The folder of that identity, which need not exist."""
        return self.folder / "identities" / who.folder_name

    # --- what it does -------------------------------------------------------------------------------------------

    def issue(self, who: Subject, valid_for: timedelta = IDENTITY_VALID_FOR, hosts: tuple[str, ...] = ()) -> Path:
        """The folder of a new identity of that role and name. hosts: of a person who serves the page, its names.

        Raises InvalidInput, and changes nothing, if there is one that is not revoked.
        """
        with self._changing() as document:
            latest = _latest(document, who)
            if latest is not None and latest.revoked_at is None:
                raise InvalidInput(f"{latest.common_name}: expected a new name, got one in use: renew it or revoke it")
            generation = 1 if latest is None else parse_common_name(latest.common_name).generation + 1
            subject = Subject(who.role, who.name, generation)
            key = new_identity_key()
            entry, files = self._certified(subject, key.public_key(), valid_for, hosts)
            make_private_folder(self.folder / "identities")
            place = make_private_folder(self.folder_of(subject))
            for name, content in {KEY: key_pem(key), **files}.items():
                write(place / name, content)
            self._commit(document, (*document.entries, entry))
        return self.folder_of(subject)

    def renew(self, who: Subject, valid_for: timedelta = IDENTITY_VALID_FOR, hosts: tuple[str, ...] = ()) -> Path:
        """The folder of that identity, with a new certificate for the same key and common name.

        Raises NotFound if there is none, InvalidInput if it is revoked.
        """
        with self._changing() as document:
            latest = _not_revoked(document, who)
            public = latest.public_key
            subject = parse_common_name(latest.common_name)
            entry, files = self._certified(subject, public, valid_for, hosts)
            make_private_folder(self.folder / "identities")
            place = make_private_folder(self.folder_of(subject))
            for name, content in files.items():
                write(place / name, content)
            self._commit(document, tuple(entry if each is latest else each for each in document.entries))
        return place

    def revoke(self, who: Subject) -> RosterEntry:
        """The entry of that identity, revoked: no router lets it in once it has the roster, no signature counts.

        Raises NotFound if there is none, InvalidInput if it is revoked already.
        """
        with self._changing() as document:
            latest = _not_revoked(document, who)
            revoked = latest.model_copy(update={"revoked_at": self._clock().replace(microsecond=0)})
            self._commit(document, tuple(revoked if each is latest else each for each in document.entries))
        return revoked

    # --- parts --------------------------------------------------------------------------------------------------

    @contextmanager
    def _changing(self) -> Iterator[RosterDocument]:
        """Within this context: the present roster, which no other process changes meanwhile."""
        with lock_beside(self.folder / ROSTER, f"{self.folder}: expected a folder of keys that nothing else changes"):
            require_valid_at(self.certificate, self._clock(), f"{self.folder}: the authority")
            yield self.roster.document

    def _certified(
        self, who: Subject, public: Ed25519PublicKey, valid_for: timedelta, hosts: tuple[str, ...]
    ) -> tuple[RosterEntry, dict[str, bytes]]:
        """The entry of an identity with a new certificate, and its files but the key."""
        now = self._clock()
        certificate = identity_certificate(who, public, self.certificate, self._key(), now, now + valid_for)
        pem = certificate_pem(certificate)
        files = {CERTIFICATE: pem, AUTHORITY: certificate_pem(self.certificate)}
        if who.role in PERSON_ROLES:
            page_key = new_page_key()
            page = page_certificate(
                who, page_key, self._page_authority(), self._page_key(), now, now + valid_for, hosts
            )
            files |= {
                PAGE_CERTIFICATE: certificate_pem(page),
                PAGE_KEY: key_pem(page_key),
                PAGE_AUTHORITY: self._page_pem,
            }
        elif hosts:
            raise InvalidInput(f"--host: expected it for {', '.join(PERSON_ROLES)}, who serve the page, got {who.role}")
        return RosterEntry(common_name=who.common_name, certificate=pem.decode()), files

    def _commit(self, document: RosterDocument, entries: tuple[RosterEntry, ...]) -> None:
        """Write the roster, here and in every identity's folder."""
        new = RosterDocument(authority=document.authority, revision=document.revision + 1, entries=entries)
        content = roster_bytes(new, self._key())
        write(self.folder / ROSTER, content)
        for place in (self.folder / "identities").iterdir():
            if place.is_dir() and not place.is_symlink():
                write(place / ROSTER, content)

    def _key(self) -> Ed25519PrivateKey:
        path = self.folder / "authority" / KEY
        key = read_key(read_private(path), str(path))
        if not isinstance(key, Ed25519PrivateKey):
            raise InvalidInput(f"{path}: expected an Ed25519 key, got another kind")
        return key

    def _page_key(self) -> EllipticCurvePrivateKey:
        path = self.folder / "authority" / PAGE_KEY
        key = read_key(read_private(path), str(path))
        if not isinstance(key, EllipticCurvePrivateKey):
            raise InvalidInput(f"{path}: expected an elliptic curve key, got another kind")
        return key

    def _page_authority(self) -> x509.Certificate:
        return read_certificate(self._page_pem, str(self.folder / "authority" / PAGE_CERTIFICATE))


def _latest(document: RosterDocument, who: Subject) -> RosterEntry | None:
    """The entry of that role and name with the highest generation; None if there is none."""
    found = [each for each in document.entries if (each.role, each.name) == (who.role, who.name)]
    return max(found, key=lambda each: parse_common_name(each.common_name).generation, default=None)


def _not_revoked(document: RosterDocument, who: Subject) -> RosterEntry:
    latest = _latest(document, who)
    if latest is None:
        raise NotFound(f"{who.common_name}: expected an identity that was issued, got none of that name")
    if latest.revoked_at is not None:
        raise InvalidInput(f"{latest.common_name}: expected a valid identity, got a revoked one: issue it anew")
    return latest
