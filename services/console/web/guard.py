"""Who may talk to the page's server: this page, from the names that the server goes by, and nobody else's page.

A page of somebody else's in the same browser must not command a rover. It could try in two ways: send requests here
across sites, or bind its own name to this address (DNS rebinding). The first carry an Origin or Sec-Fetch-Site that is
not ours and lack a header that no cross-site form can set; the second carry a Host that is not ours.
"""

from __future__ import annotations

from collections.abc import Iterable

from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

TOKEN_HEADER = b"x-he3-console"
MAX_BODY_BYTES = 65_536

_HEADERS = (
    (
        b"content-security-policy",
        b"default-src 'self'; img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
)


class Guard:
    """Lets requests through that come to one of `hosts` (names without port) and from this page itself."""

    def __init__(self, app: ASGIApp, hosts: Iterable[str]) -> None:
        self._app = app
        self._hosts = frozenset(host.lower() for host in hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        why = self._objection(scope)
        if why is not None:
            response = JSONResponse({"error": why}, status_code=403)
            return await response(scope, receive, send)

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *_HEADERS]
            await send(message)

        return await self._app(scope, receive, with_headers)

    def _objection(self, scope: Scope) -> str | None:
        headers = {bytes(name).lower(): bytes(value).decode("latin-1") for name, value in scope["headers"]}
        host = headers.get(b"host", "")
        if _name(host) not in self._hosts:
            return (
                f"expected one of the hosts {', '.join(sorted(self._hosts))} (see he3 web --allow-host), got '{host}'"
            )
        if headers.get(b"sec-fetch-site", "none") not in ("same-origin", "none"):
            return "expected a request of this page's own, got one from another site"
        if scope["method"] in ("GET", "HEAD"):
            return None
        origin = headers.get(b"origin", "")
        if origin.partition("://")[2].lower() != host.lower():
            return f"expected the origin {host}, got '{origin}'"
        if TOKEN_HEADER not in headers or not headers.get(b"content-type", "").startswith("application/json"):
            return "expected JSON and the header that this page sends"
        if int(headers.get(b"content-length", "0") or 0) > MAX_BODY_BYTES or b"transfer-encoding" in headers:
            return f"expected at most {MAX_BODY_BYTES} bytes with their length said, got more"
        return None


def _name(host: str) -> str:
    """The host without its port."""
    if host.startswith("["):
        return host[: host.find("]") + 1].lower()
    return host.partition(":")[0].lower()
