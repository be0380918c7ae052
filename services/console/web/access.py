"""Access to the page: the caller of each request, and the caller's rights.

There are three ways to log in. A browser on the server's own machine may read without a login, if the page listens on
loopback alone. The address that `he3 web` prints once holds a token: a browser that opens it gets a session, kept in a
cookie. And under TLS a person's certificate of the mission (`he3 keys issue operator anna`) is enough. Tokens and
sessions are kept as hashes.

What a role may do is decided here, on the server; the page only hides what the server would refuse.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from http.cookies import CookieError, SimpleCookie

from he3.errors import InvalidInput
from schemas.roles import PERSON_ROLES, Role

SESSION_S = 12 * 3600.0
"""A session ends after this time [s]."""
MAX_SESSIONS = 1000
"""Most sessions of one login; beyond it the oldest one of that login ends, and no other's."""
MAX_COOKIE_CHARACTERS = 4096

READ = frozenset(PERSON_ROLES)
COMMAND = frozenset({Role.OPERATOR})
CONTROL = frozenset({Role.CONTROLLER})
ACT = COMMAND | CONTROL
"""Roles of which a caller needs one: to read, to command the rover, to change the link, or for either change."""


@dataclass(frozen=True, slots=True)
class Caller:
    """A person at a browser."""

    name: str
    """Common name of the certificate, such as `operator.anna`; without one, the way of the login."""
    roles: frozenset[Role]
    logged_in: bool = field(default=False, compare=False)
    """Whether the request belongs to a session, which the person can end."""

    def document(self) -> dict[str, object]:
        """The caller as a JSON document for the page."""
        return {
            "name": self.name,
            "roles": sorted(self.roles),
            "commands": bool(self.roles & COMMAND),
            "controls": bool(self.roles & CONTROL),
            "logged_in": self.logged_in,
        }


Certified = Callable[[str], Caller]
"""Returns the caller for a certificate's common name; raises InvalidInput for a revoked one or one of no person."""


def no_certificates(common_name: str) -> Caller:
    """Refuses every certificate: for a server without a roster of people."""
    raise InvalidInput(
        f"expected a login, got a certificate of '{common_name[:80]}', which this server does not accept"
    )


class Access:
    """The tokens and sessions, and the rights of each."""

    def __init__(
        self,
        port: int,
        *,
        anonymous: frozenset[Role] = frozenset(),
        certified: Certified = no_certificates,
        able: frozenset[Role] = READ,
        secure: bool = False,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """anonymous: roles without a login. able: the rights of the server itself; no caller has more.

        secure: whether the page is served over TLS.
        """
        self._anonymous = Caller("local", anonymous) if anonymous else None
        self._certified = certified
        self._able = able
        self._secure = secure
        self._now = now
        self._tokens: dict[bytes, Caller] = {}
        self._sessions: dict[bytes, tuple[float, Caller]] = {}
        # Cookies know no ports: two missions on one machine must not end each other's sessions.
        self._cookie = f"{'__Host-' if secure else ''}he3-{port}"

    def new_token(self, caller: Caller) -> str:
        """A token with which a session of that caller begins; only its hash is kept."""
        token = secrets.token_urlsafe(32)
        self._tokens[_hash(token)] = caller
        return token

    def log_in(self, token: str) -> str | None:
        """The Set-Cookie header of a new session; None for an unknown token."""
        given = _hash(token)
        caller = next((each for known, each in self._tokens.items() if hmac.compare_digest(known, given)), None)
        if caller is None:
            return None
        session = secrets.token_urlsafe(32)
        self._forget_old(caller)
        self._sessions[_hash(session)] = self._now() + SESSION_S, caller
        return self._header(session, SESSION_S)

    def log_out(self, cookies: str) -> str:
        """End the session of a request with that Cookie header, if there is one; returns a Set-Cookie header.

        The header removes the cookie from the browser. Other browsers that logged in with the same token stay.
        """
        self._sessions.pop(_hash(self._cookie_in(cookies)), None)
        return self._header("", 0.0)

    def _header(self, value: str, lasts_s: float) -> str:
        secure = "; Secure" if self._secure else ""
        return f"{self._cookie}={value}; HttpOnly; SameSite=Strict; Path=/; Max-Age={lasts_s:.0f}{secure}"

    def caller(self, cookies: str, common_name: str | None) -> Caller | None:
        """Who sends a request with that Cookie header, over a connection with that certificate; None for an unknown
        one. Raises InvalidInput for a certificate that is revoked or expired.
        """
        caller = self._found(cookies, common_name)
        return None if caller is None else replace(caller, roles=caller.roles & self._able or frozenset({Role.VIEWER}))

    def _found(self, cookies: str, common_name: str | None) -> Caller | None:
        if common_name is not None:
            return self._certified(common_name)
        session = self._sessions.get(_hash(self._cookie_in(cookies)))
        if session is not None and session[0] > self._now():
            return replace(session[1], logged_in=True)
        return self._anonymous

    def _cookie_in(self, header: str) -> str:
        if len(header) > MAX_COOKIE_CHARACTERS:
            return ""
        try:
            found = SimpleCookie(header).get(self._cookie)
        except CookieError:
            return ""
        return "" if found is None else found.value

    def _forget_old(self, caller: Caller) -> None:
        """Make room for a further session of that login."""
        now = self._now()
        kept = {key: session for key, session in self._sessions.items() if session[0] > now}
        own = [key for key, (_, whose) in kept.items() if whose == caller]
        for key in own[: max(0, len(own) + 1 - MAX_SESSIONS)]:
            del kept[key]
        self._sessions = kept


def common_name_of_peer(certificate: Mapping[str, object] | None) -> str | None:
    """The common name in `ssl`'s data on a peer's certificate; None without a certificate, empty without a name."""
    if not certificate:
        return None
    subject = certificate.get("subject", ())
    assert isinstance(subject, tuple), "as ssl.SSLSocket.getpeercert documents"
    names = [value for part in subject for key, value in part if key == "commonName"]
    return str(names[0]) if len(names) == 1 else ""


def _hash(text: str) -> bytes:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).digest()
