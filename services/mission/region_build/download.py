"""Parts of a large file on an HTTP server, kept in a sparse file of the same length: only what is asked for is fetched.

A state file beside it holds the ranges that are there, and the server's ETag. A download that was broken off continues
where it was. If the file on the server has changed meanwhile, it begins anew. Source: RFC 9110, section 14 (ranges).
"""

from __future__ import annotations

import hashlib
import http.client
import json
import re
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Final

from he3.errors import He3Error

MAX_REQUEST_BYTES: Final = 4 * 1024 * 1024
ATTEMPTS: Final = 5  # in a row without a byte
_PIECE: Final = 64 * 1024
_TRANSIENT: Final = (500, 502, 503, 504, 429)

Range = tuple[int, int]
"""First byte, and the one after the last."""


class RemoteFile:
    """A file on a server, read by ranges through a sparse file here."""

    def __init__(
        self, url: str, path: Path, progress: Callable[[str], None] = lambda line: None, timeout_s: float = 30.0
    ) -> None:
        """timeout_s: of a connection, and of each wait for bytes."""
        self.url, self.path = url, path
        self._progress, self._timeout_s = progress, timeout_s
        self._state = path.with_name(path.name + ".ranges.json")
        self.etag = ""
        self.length = 0
        self.ranges: list[Range] = []
        """What is here, in order, without overlap."""
        self._load()

    def read(self, offset: int, length: int) -> bytes:
        """Those bytes, fetched if they are not here; fewer at the file's end. Raises He3Error."""
        if self.length == 0:
            self._fetch(0, 1)
        end = min(offset + length, self.length)
        self.need([(offset, end)])
        with self.path.open("rb") as stream:
            stream.seek(offset)
            return stream.read(max(0, end - offset))

    def need(self, wanted: list[Range]) -> None:
        """Fetch what is missing of those ranges. Raises He3Error; what has arrived stays here."""
        missing = [part for one in joined(wanted, 0) for part in without(one, self.ranges)]
        parts = joined(missing, _PIECE)
        total, done = sum(end - first for first, end in parts), 0
        for first, end in parts:
            at = first
            while at < end:
                stop = min(end, at + MAX_REQUEST_BYTES)
                self._fetch(at, stop)
                done += stop - at
                at = stop
                if total > MAX_REQUEST_BYTES // 4:
                    self._progress(f"{self.path.name}: {done / 1e6:.1f} of {total / 1e6:.1f} MB")

    def checksum(self) -> str:
        """SHA-256 of the ranges that are here, in order."""
        found = hashlib.sha256()
        with self.path.open("rb") as stream:
            for first, end in self.ranges:
                stream.seek(first)
                found.update(stream.read(end - first))
        return found.hexdigest()

    def forget(self) -> None:
        """Take all that is here for missing."""
        self.ranges = []

    def _fetch(self, first: int, end: int) -> None:
        """Fetch that range, with repetitions as long as bytes arrive."""
        failures = 0
        while first < end:
            try:
                got = self._request(first, end)
            except (OSError, http.client.HTTPException) as error:
                if isinstance(error, urllib.error.HTTPError):
                    error.close()  # it is the reply, too, and holds the connection
                failures += 1
                if failures >= ATTEMPTS or self._is_final(error):
                    raise He3Error(f"{self.url}: cannot fetch: {_reason(error)}; what has arrived is kept") from None
                continue
            failures = 0 if got else failures + 1
            if failures >= ATTEMPTS:
                raise He3Error(f"{self.url}: cannot fetch: the server sends no bytes; what has arrived is kept")
            first += got

    def _request(self, first: int, end: int) -> int:
        """One request; bytes that arrived. They are written, also if the connection breaks after them."""
        headers = {"Range": f"bytes={first}-{end - 1}", "Accept-Encoding": "identity", "User-Agent": "he3-seeker"}
        request = urllib.request.Request(self.url, headers=headers)
        with urllib.request.urlopen(request, timeout=self._timeout_s) as reply:
            total = re.fullmatch(rf"bytes {first}-\d+/(\d+)", reply.headers.get("Content-Range", ""))
            if reply.status != 206 or total is None:
                raise He3Error(f"{self.url}: expected a reply to a range request (206), got {reply.status}")
            if self._take_identity(reply.headers.get("ETag", ""), int(total[1])) and first > 0:
                raise He3Error(f"{self.url}: the file has changed on the server; run the command again")
            got = 0
            with self.path.open("r+b") as stream:
                stream.seek(first)
                try:
                    while first + got < end and (piece := reply.read1(min(_PIECE, end - first - got))):
                        stream.write(piece)
                        got += len(piece)
                except (OSError, http.client.HTTPException):
                    if got == 0:
                        raise
        if got:
            self.ranges = joined([*self.ranges, (first, first + got)], 0)
            self._save()
        return got

    def _take_identity(self, etag: str, length: int) -> bool:
        """Whether the file is another than the one that is here; then what is here is dropped."""
        changed = self.length != 0 and (etag, length) != (self.etag, self.length)
        if self.length == 0 or changed:
            self.etag, self.length, self.ranges = etag, length, []
            with self.path.open("wb") as stream:
                stream.truncate(length)
            self._save()
        return changed

    @staticmethod
    def _is_final(error: Exception) -> bool:
        if isinstance(error, urllib.error.HTTPError):
            return error.code not in _TRANSIENT
        reason = getattr(error, "reason", error)
        return isinstance(reason, ConnectionRefusedError) or "getaddrinfo" in repr(reason) or "gaierror" in repr(reason)

    def _load(self) -> None:
        try:
            state = json.loads(self._state.read_text(encoding="utf-8"))
            if state["url"] == self.url and self.path.stat().st_size == state["length"]:
                self.etag, self.length = str(state["etag"]), int(state["length"])
                self.ranges = joined([(int(first), int(end)) for first, end in state["ranges"]], 0)
        except (OSError, ValueError, KeyError, TypeError):
            self.length, self.ranges = 0, []  # nothing usable is here

    def _save(self) -> None:
        state = {"url": self.url, "etag": self.etag, "length": self.length, "ranges": self.ranges}
        scratch = self._state.with_name(self._state.name + ".part")
        scratch.write_text(json.dumps(state), encoding="utf-8")
        scratch.replace(self._state)


def joined(ranges: list[Range], gap: int) -> list[Range]:
    """The ranges in order; those at most ``gap`` bytes apart are one."""
    found: list[Range] = []
    for first, end in sorted(part for part in ranges if part[1] > part[0]):
        if found and first <= found[-1][1] + gap:
            found[-1] = found[-1][0], max(found[-1][1], end)
        else:
            found.append((first, end))
    return found


def without(wanted: Range, present: list[Range]) -> list[Range]:
    """The parts of a range that are not present; ``present`` is in order."""
    missing, at = [], wanted[0]
    for first, end in present:
        if end <= at or first >= wanted[1]:
            continue
        if first > at:
            missing.append((at, first))
        at = max(at, end)
    return [*missing, (at, wanted[1])] if at < wanted[1] else missing


def _reason(error: Exception) -> str:
    if isinstance(error, urllib.error.HTTPError):
        return f"HTTP {error.code} {error.reason}"
    reason = getattr(error, "reason", error)
    return str(getattr(reason, "strerror", None) or reason) or type(error).__name__
