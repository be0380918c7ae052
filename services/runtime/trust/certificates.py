"""X.509 certificates of a mission: made, read and checked. Pure: bytes and times in, values out.

An identity's certificate has one Ed25519 key for both TLS and signatures. Zenoh's access control knows a peer by the
common name of its certificate, `ROLE.NAME`. After a revocation the same role and name get a new common name,
`ROLE.NAME.2`, so that the revoked certificate has no rights although it has not expired.

Only the link's certificate may serve: a process that connects to a router refuses every other certificate, so that no
other identity of the mission can pose as the router.
"""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePrivateKey, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from he3.errors import InvalidInput
from schemas.roles import Role

CLOCK_SKEW = timedelta(minutes=5)
"""A certificate is valid from this long before it was made, because clocks of two machines differ."""
LOOPBACK_HOSTS = ("localhost", "127.0.0.1", "::1")

PrivateKey = Ed25519PrivateKey | EllipticCurvePrivateKey
_COMMON_NAME = re.compile(r"([a-z]+)\.([a-z0-9][a-z0-9_-]{0,31})(?:\.([2-9]|[1-9]\d{1,8}))?")
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")


@dataclass(frozen=True, slots=True)
class Subject:
    """The owner of a certificate: role, name and generation."""

    role: Role
    name: str
    generation: int = 1
    """Begins at 1, and grows by one with each revocation."""

    @property
    def common_name(self) -> str:
        return f"{self.role.value}.{self.name}" + (f".{self.generation}" if self.generation > 1 else "")

    @property
    def folder_name(self) -> str:
        """Name of the folder of this identity."""
        return f"{self.role.value}-{self.name}"


def subject(role: str, name: str) -> Subject:
    """The subject of that role and name; raises InvalidInput for an unknown role or an invalid name."""
    if role not in set(Role):
        raise InvalidInput(f"role: expected one of {', '.join(Role)}, got '{role[:40]}'")
    if not _NAME.fullmatch(name):
        raise InvalidInput(f"name: expected at most 32 of a-z, 0-9, '-' and '_', got '{name[:80]}'")
    return Subject(Role(role), name)


def parse_common_name(common_name: str) -> Subject:
    """The subject that a common name stands for; raises InvalidInput."""
    found = _COMMON_NAME.fullmatch(common_name)
    if found is None or found[1] not in set(Role):
        raise InvalidInput(f"common name: expected ROLE.NAME such as operator.anna, got '{common_name[:80]}'")
    return Subject(Role(found[1]), found[2], int(found[3] or 1))


# --- made ---------------------------------------------------------------------------------------------------------


def self_signed(title: str, key: PrivateKey, now: datetime, valid_for: timedelta) -> x509.Certificate:
    """The certificate of an authority of that title."""
    return (
        _builder(_x509_name(title), _x509_name(title), key.public_key(), now, now + valid_for)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(signs_certificates=True), critical=True)
        .sign(key, _digest(key))
    )


def identity_certificate(
    who: Subject,
    public_key: Ed25519PublicKey,
    authority: x509.Certificate,
    authority_key: PrivateKey,
    now: datetime,
    expires: datetime,
) -> x509.Certificate:
    """The certificate of an identity. Only the link's may serve TLS; every one may connect."""
    usages = [ExtendedKeyUsageOID.CLIENT_AUTH]
    if who.role is Role.LINK:
        usages.append(ExtendedKeyUsageOID.SERVER_AUTH)
    return _issued(who, public_key, authority, authority_key, now, expires, usages, ())


def page_certificate(
    who: Subject,
    key: EllipticCurvePrivateKey,
    authority: x509.Certificate,
    authority_key: PrivateKey,
    now: datetime,
    expires: datetime,
    hosts: tuple[str, ...] = (),
) -> x509.Certificate:
    """The certificate of a person for the page: for the browser, and for the page's server on those hosts.

    It is signed by a separate authority, so a page's certificate is never accepted as a router's.
    """
    usages = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    public_key = key.public_key()
    return _issued(who, public_key, authority, authority_key, now, expires, usages, (*LOOPBACK_HOSTS, *hosts))


def _issued(
    who: Subject,
    public_key: Any,
    authority: x509.Certificate,
    authority_key: PrivateKey,
    now: datetime,
    expires: datetime,
    usages: list[x509.ObjectIdentifier],
    hosts: tuple[str, ...],
) -> x509.Certificate:
    until = min(expires, authority.not_valid_after_utc)
    builder = (
        _builder(_x509_name(who.common_name), authority.subject, public_key, now, until)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
    )
    # A certificate without any alternative name is refused by some TLS libraries.
    names = [_general_name(host) for host in hosts] or [x509.DNSName(f"{who.folder_name}.he3.invalid")]
    builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return builder.sign(authority_key, _digest(authority_key))


def _builder(
    who: x509.Name, issuer: x509.Name, public_key: Any, now: datetime, until: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(who)
        .issuer_name(issuer)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(now, until) - CLOCK_SKEW)
        .not_valid_after(until)
    )


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _x509_name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        return x509.DNSName(host)
    except ValueError:
        raise InvalidInput(f"--host: expected a host name or an address, got '{host[:80]}'") from None


def _digest(key: PrivateKey) -> hashes.SHA256 | None:
    """The digest to sign with; None for Ed25519, which has its own."""
    return None if isinstance(key, Ed25519PrivateKey) else hashes.SHA256()


def new_identity_key() -> Ed25519PrivateKey:
    return Ed25519PrivateKey.generate()


def new_page_key() -> EllipticCurvePrivateKey:
    return generate_private_key(SECP256R1())


# --- written and read ---------------------------------------------------------------------------------------------


def certificate_pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def key_pem(key: PrivateKey) -> bytes:
    """The private key, without a password, because services start without a person who could type it."""
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def read_certificate(pem: bytes, where: str) -> x509.Certificate:
    """The certificate of that PEM text; raises InvalidInput that names `where`."""
    try:
        return x509.load_pem_x509_certificate(pem)
    except ValueError:
        raise InvalidInput(f"{where}: expected a certificate (PEM), got something else") from None


def read_key(pem: bytes, where: str) -> Any:
    """The private key of that PEM text; raises InvalidInput that names `where`, and never shows the text."""
    try:
        return serialization.load_pem_private_key(pem, password=None)
    except (ValueError, TypeError):
        raise InvalidInput(f"{where}: expected a private key (PEM, no password), got something else") from None


# --- checked ------------------------------------------------------------------------------------------------------


def common_name_of(certificate: x509.Certificate) -> str:
    """The common name of a certificate; empty if it has none, or several."""
    found = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(found[0].value) if len(found) == 1 else ""


def require_issued_by(certificate: x509.Certificate, authority: x509.Certificate, where: str) -> Subject:
    """The subject of a certificate of that authority; raises InvalidInput that names `where` for another's."""
    try:
        certificate.verify_directly_issued_by(authority)
    except Exception:  # noqa: BLE001 - cryptography raises its own error, ValueError or TypeError: none is a defect here
        raise InvalidInput(
            f"{where}: expected a certificate of this mission's authority, got one of another authority"
        ) from None
    return parse_common_name(common_name_of(certificate))


def require_valid_at(certificate: x509.Certificate, now: datetime, where: str) -> None:
    """Raise InvalidInput that names `where` unless the certificate is valid at that time."""
    if now > certificate.not_valid_after_utc:
        raise InvalidInput(f"{where}: the certificate expired at {certificate.not_valid_after_utc:%Y-%m-%d %H:%M} UTC")
    if now < certificate.not_valid_before_utc:
        begin = certificate.not_valid_before_utc
        raise InvalidInput(f"{where}: the certificate is valid from {begin:%Y-%m-%d %H:%M} UTC on, not yet")


def fingerprint(certificate: x509.Certificate) -> str:
    """SHA-256 of the certificate, in hexadecimal."""
    return certificate.fingerprint(hashes.SHA256()).hex()


def utc_now() -> datetime:
    """The time of this machine: certificates are about wall time, not mission time."""
    return datetime.now(UTC)
