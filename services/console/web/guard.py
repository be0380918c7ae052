"""Which requests the page's server answers: those of this page itself, under a name or address of this server.

A page of another site in the same browser must not command a rover. It could try in two ways: send requests here across
sites, or bind its own name to this address (DNS rebinding). The first carry an Origin or Sec-Fetch-Site of another site
and lack a header that no cross-site form can set; the second carry a Host that is not a name of this server. A Host
that is the very IP address that the connection came to is always ours: no name was looked up. `localhost` and the
addresses of loopback are ours only over loopback.
"""

from __future__ import annotations

from collections.abc import Iterable

from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services.console.web.address import LOOPBACK_NAMES, address_of, normal_host

TOKEN_HEADER = b"x-he3-console"
MAX_BODY_BYTES = 65_536
ONCE = (b"host", b"origin", b"cookie", b"content-type", b"content-length", b"sec-fetch-site", TOKEN_HEADER)
"""Headers that may occur once only: two layers could read different copies."""

_HEADERS = (
    (
        b"content-security-policy",
        b"default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data: blob:; "
        b"frame-ancestors 'none'; base-uri 'none'; form-action 'none'; require-trusted-types-for 'script'",
    ),
    (b"x-frame-options", b"DENY"),
    (b"permissions-policy", b"camera=(), geolocation=(), microphone=(), payment=(), usb=()"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
)


class Guard:
    """Lets requests through that come to one of `hosts` (as `normal_host` spells them) and from this page itself."""

    def __init__(self, app: ASGIApp, hosts: Iterable[str]) -> None:
        self._app = app
        self._hosts = frozenset(hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return await self._app(scope, receive, send)

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *_HEADERS]
            await send(message)

        objection = self._objection(scope)
        if objection is not None:
            why, code = objection
            response = JSONResponse({"error": why}, status_code=code)
            return await response(scope, receive, with_headers)
        return await self._app(scope, receive, with_headers)

    def _objection(self, scope: Scope) -> tuple[str, int] | None:
        """Why the request is refused, and the status code; None for a request that is answered."""
        names = [bytes(name).lower() for name, _ in scope["headers"]]
        if any(names.count(name) > 1 for name in ONCE):
            return "expected each header once, got one twice", 400
        headers = {bytes(name).lower(): bytes(value).decode("latin-1") for name, value in scope["headers"]}
        host = headers.get(b"host", "")
        if not self._is_ours(host, scope):
            known = ", ".join(sorted(self._hosts))
            return f"expected one of the hosts {known} (see he3 web --allow-host), got '{host[:100]}'", 403
        if headers.get(b"sec-fetch-site", "none") not in ("same-origin", "none"):
            return "expected a request of this page, got one of another site", 403
        if scope["method"] in ("GET", "HEAD"):
            return None
        origin, expected = headers.get(b"origin", ""), f"{scope['scheme']}://{host}"
        if origin.lower() != expected.lower():
            return f"expected the origin {expected}, got '{origin[:100]}'", 403
        if TOKEN_HEADER not in headers or not headers.get(b"content-type", "").startswith("application/json"):
            return "expected JSON and the header that this page sends, got another request", 403
        length = headers.get(b"content-length", "0").strip() or "0"
        if b"transfer-encoding" in headers or not length.isascii() or not length.isdigit():
            return "expected a body of a stated length, got one without", 411
        if len(length) > 9 or int(length) > MAX_BODY_BYTES:
            return f"expected at most {MAX_BODY_BYTES} bytes, got {length[:20]}", 413
        return None

    def _is_ours(self, host: str, scope: Scope) -> bool:
        name = normal_host(host)
        if name is None:
            return False
        here = address_of((scope.get("server") or ("",))[0])
        if here is not None and (address_of(name) == here or (name in LOOPBACK_NAMES and here.is_loopback)):
            return True
        return name in self._hosts and name not in LOOPBACK_NAMES
