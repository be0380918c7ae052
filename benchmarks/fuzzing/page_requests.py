"""Random requests to the page of a mission in real processes: no status of 500 or above, no hang.

The mission runs at rate 1, so it hardly changes during the requests.
"""

from __future__ import annotations

import http.client
import json
import re
import ssl
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from random import Random
from typing import Any
from urllib.parse import quote, urlencode

import numpy as np

from benchmarks.fuzzing import values
from benchmarks.fuzzing.surface import one_line
from he3.errors import He3Error
from services.console.client.mission_client import MissionClient
from services.console.launch.endpoints import free_endpoints
from services.console.launch.launcher import Launcher
from services.runtime.trust.authority import Authority
from services.runtime.trust.certificates import subject
from services.runtime.trust.identity import PAGE_AUTHORITY, PAGE_CERTIFICATE, PAGE_KEY

MISSION = "fuzzed"
MOST_PER_S = 200.0
"""Most requests over TLS per second."""
LOOK_EVERY, SETTLED_AFTER = 500, 4000
"""Requests between two looks at the memory, and after which it has to stay flat."""
MOST_GROWTH = 1.1
ANSWER_S = 60.0
"""Time limit [s] for an answer, on a busy machine."""

QUERIES: dict[str, dict[str, str]] = {
    "/api/map/point": {"x": "5", "y": "6", "threshold": "8"},
    "/api/map/layer": {"layer": "mean", "format": "json", "step": "2", "threshold": "8"},
    "/api/map/box": {"layer": "std", "x_min": "1", "x_max": "9", "y_min": "1", "y_max": "9", "resolution_m": "1"},
    "/api/map/resource": {"polygon": "1,1 9,1 5,9", "cutoff_ppb": "8", "probability": "0.9"},
    "/api/map/track": {"as_of": "1"},
    "/api/map/history": {},
    "/api/interest": {},
    "/api/colours": {},
}
POSTS: dict[str, dict[str, Any]] = {
    "/api/command": {"kind": "pause", "expires_in_s": 60, "target_m": [5.0, 5.0], "area_id": "area-1",
                     "polygon_m": [[1, 1], [9, 1], [5, 9]]},
    "/api/link": {"direction": "up", "one_way_light_time_s": 1.3, "loss": 0.1, "rate_bit_s": 2000.0, "contact": True},
    "/api/interest": {"area_id": "area-1", "polygon_m": [[1, 1], [9, 1], [5, 9]], "weight": 2},
    "/api/acknowledge": {"id": "none"},
}  # fmt: skip


PATHS = (
    "/", "/static/main.js", "/static/../server.py", "/static/%2e%2e/server.py", "/api", "//", "/api/map/none",
)  # fmt: skip
BODIES = (b"", b"[" * 30_000, b"9" * 6_000, b"\xff\xfe")


class ServedPage:
    """The page's server of a running mission, and malformed requests."""

    scheme = "http"

    def __init__(self, mission: str, earth: str, flags: Sequence[str] = ()) -> None:
        """flags: more ones of the server."""
        self._cookie = ""
        command = [sys.executable, "-m", "services.console", "web", "--port", "0", "--authority",
                   "--mission", mission, "--earth", earth, *flags]  # fmt: skip
        self._server = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            self._find(mission)
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        return self._server.pid

    def _find(self, mission: str) -> None:
        assert self._server.stderr is not None
        line = self._server.stderr.readline()
        found = re.search(r"https?://([\w.]+):(\d+)/(login[^\s,]+)?", line)
        if found is None:
            raise He3Error(f"expected the address of the page of '{mission}', got {line!r}")
        self._host, self._port = found[1], int(found[2])
        if found[3] is not None:
            self._log_in(f"/{found[3]}")
        while not self._has_a_map():
            self.require_alive()

    def require_alive(self) -> None:
        """Raise He3Error if the server has ended."""
        if self._server.poll() is not None:
            raise He3Error("the page's server has ended")

    def _connection(self) -> http.client.HTTPConnection:
        return http.client.HTTPConnection(self._host, self._port, timeout=ANSWER_S)

    def _log_in(self, path: str) -> None:
        connection = self._connection()
        connection.request("GET", path)
        self._cookie = connection.getresponse().getheader("set-cookie", "").partition(";")[0]
        connection.close()

    def _has_a_map(self) -> bool:
        """Whether the page can answer queries of the map: the ground has a map soon after it has begun."""
        connection = self._connection()
        try:
            connection.request("GET", "/api/map/history", headers={"cookie": self._cookie})
            return connection.getresponse().status == 200
        except ConnectionError:
            return False
        finally:
            connection.close()

    def close(self) -> None:
        """End the server."""
        self._server.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._server.wait(10)
        self._server.kill()
        self._server.wait()
        if self._server.stderr is not None:
            self._server.stderr.close()

    def example(self, rng: Random) -> tuple[str, str | None]:
        """One request: its first line and body, and a line on its fault, None if there was none."""
        method, target, headers, body = self._request(rng)
        what = f"{method} {target[:200]} {dict(headers)} {(body or b'')[:200]!r}"
        connection = self._connection()
        try:
            connection.putrequest(method, target, skip_host="host" in {name.lower() for name, _ in headers},
                                  skip_accept_encoding=True)  # fmt: skip
            for name, value in headers:
                connection.putheader(name, value)
            connection.endheaders(body)
            response = connection.getresponse()
            payload = response.read() if target.split("?")[0] != "/api/stream" else b""
        except (ValueError, http.client.InvalidURL, UnicodeError):
            return what, None  # the client itself does not send this
        except TimeoutError:
            return what, f"no answer within {ANSWER_S:g} s"
        except (ConnectionError, http.client.HTTPException, ssl.SSLEOFError) as error:
            return what, self._gone(error)
        finally:
            connection.close()
        if response.status >= 500:
            return what, f"status {response.status}: {payload[:300]!r}"
        if (
            response.status == 400
            and method != "HEAD"
            and response.getheader("content-type", "").startswith("application/json")
        ):
            return what, one_line(str(json.loads(payload)["error"]))
        return what, None

    def _gone(self, error: Exception) -> str | None:
        """What is wrong after the server closed a connection: it may refuse bytes that are no HTTP, but not end."""
        return None if self._server.poll() is None else f"the server has ended: {type(error).__name__}: {error}"

    def _request(self, rng: Random) -> tuple[str, str, list[tuple[str, str]], bytes | None]:
        headers = [("host", f"{self._host}:{self._port}")]
        if rng.random() < 0.9:
            headers.append(("cookie", self._cookie))
        if rng.random() < 0.05:
            headers[0] = ("host", quote(values.text(rng)[:200].encode("utf-8", "surrogateescape")))
        if rng.random() < 0.5:
            path = rng.choice(list(QUERIES))
            parameters: list[tuple[str, str]] = [
                (name, _word(rng) if rng.random() < 0.35 else value)
                for name, value in QUERIES[path].items()
                if rng.random() < 0.9
            ]
            if rng.random() < 0.2:
                parameters.append((values.text(rng)[:200], _word(rng)))
            return rng.choice(("GET", "GET", "GET", "HEAD", "POST")), f"{path}?{_encoded(parameters)}", headers, None
        if rng.random() < 0.15:
            path = rng.choice(PATHS)
            return rng.choice(("GET", "PUT", "DELETE", "OPTIONS", "BREW")), path, headers, None
        path = rng.choice(list(POSTS))
        document = POSTS[path]
        for _ in range(rng.choice((0, 1, 1, 2, 3))):
            document = values.mutated(rng, document)
        body = json.dumps(document).encode("utf-8", "surrogatepass")
        if rng.random() < 0.1:
            body = rng.choice((*BODIES, body[: len(body) // 2], rng.randbytes(100)))
        headers += [
            ("content-type", "application/json"),
            ("x-he3-console", "1"),
            ("origin", f"{self.scheme}://{headers[0][1]}"),
        ]
        if rng.random() < 0.9:
            headers.append(("content-length", str(len(body) if rng.random() < 0.9 else rng.choice((0, len(body))))))
        if rng.random() < 0.1:
            headers = [header for header in headers if rng.random() < 0.7]
        return "POST", path, headers, body


class ServedPageOverTls(ServedPage):
    """The same over TLS."""

    scheme = "https"

    def __init__(self, mission: str, earth: str, identity: Path) -> None:
        """identity: folder of the page's identity, of a person."""
        self._tls = ssl.create_default_context(cafile=identity / PAGE_AUTHORITY)
        flags = [
            "--page-identity",
            identity,
            "--certificate",
            identity / PAGE_CERTIFICATE,
            "--key",
            identity / PAGE_KEY,
        ]
        super().__init__(mission, earth, [str(flag) for flag in flags])

    def _connection(self) -> http.client.HTTPConnection:
        return http.client.HTTPSConnection(self._host, self._port, timeout=ANSWER_S, context=self._tls)


class PageRequests:
    """A mission at rate 1, its page, and malformed requests."""

    name = "page"

    def __init__(self, folder: Path) -> None:
        region = folder / "region.npz"
        _, x = np.mgrid[0:20, 0:20].astype(float)
        np.savez(region, he3_ppb=8 + np.sin(x / 5), traversable=np.ones((20, 20), bool), resolution_m=1.0)
        scenario = folder / "fuzzed.toml"
        scenario.write_text(
            f'name = "{MISSION}"\nregion = "{region}"\nrounds = 3\nsamples_per_round = 2\nstart_m = [5.0, 5.0]\n'
            "[ground]\nplanning_s = 1.0\nclearance_m = 1.0\n"
        )
        with ExitStack() as ends:
            endpoints = free_endpoints()
            self._launcher = ends.enter_context(Launcher(scenario, endpoints, ("--rate", "1"), logs=folder))
            MissionClient.when_up(endpoints.earth, MISSION, self._launcher.check).close()
            self._page = self._served(folder, endpoints.earth)
            ends.callback(self._page.close)
            self._ends = ends.pop_all()

    def _served(self, _folder: Path, earth: str) -> ServedPage:
        return ServedPage(MISSION, earth)

    def example(self, rng: Random) -> tuple[str, str | None]:
        """One request: its first line and body, and a line on its fault, None if there was none."""
        return self._page.example(rng)

    def close(self) -> None:
        """End the server, then the mission."""
        self._ends.close()


class PageRequestsOverTls(PageRequests):
    """The same over TLS, at a bounded rate, with an eye on the memory of the page's server and of every service."""

    name = "page-tls"

    def __init__(self, folder: Path) -> None:
        self._examples = 0
        self._began = time.monotonic()
        self._settled_kb: dict[str, int] = {}
        super().__init__(folder)

    def _served(self, folder: Path, earth: str) -> ServedPage:
        return ServedPageOverTls(MISSION, earth, Authority.create(folder / "keys").issue(subject("operator", "fuzz")))

    def example(self, rng: Random) -> tuple[str, str | None]:
        """Send one request at its time, and check that memory and services have not changed."""
        self._examples += 1
        if self._examples == 1:
            self._began = time.monotonic()
        time.sleep(max(0.0, self._began + self._examples / MOST_PER_S - time.monotonic()))
        what, wrong = super().example(rng)
        if wrong is None and self._examples % LOOK_EVERY == 0:
            wrong = self._grown()
        return what, wrong

    def _grown(self) -> str | None:
        """Which process has grown or ended, in one line; None if none has."""
        self._launcher.check()
        pids = {"page": self._page.pid, **self._launcher.pids}
        now_kb = {name: resident_kb(pid) for name, pid in pids.items()}
        if self._examples == SETTLED_AFTER:
            self._settled_kb = now_kb
        shown = ", ".join(f"{name} {kb / 1024:.0f} MB" for name, kb in now_kb.items())
        print(f"fuzz: {self.name} {self._examples}: {shown}", file=sys.stderr)
        for name, settled in self._settled_kb.items():
            if now_kb[name] > MOST_GROWTH * settled:
                return f"{name} has grown from {settled} kB to {now_kb[name]} kB"
        return None


def resident_kb(pid: int) -> int:
    """Memory of that process [kB]; Linux."""
    found = re.search(r"^VmRSS:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text(encoding="ascii"), re.MULTILINE)
    return 0 if found is None else int(found[1])


def _word(rng: Random) -> str:
    return rng.choice((values.text(rng)[:5_000], str(values.integer(rng)), repr(values.number(rng))))


def _encoded(parameters: list[tuple[str, str]]) -> str:
    as_bytes = [[word.encode("utf-8", "surrogateescape") for word in parameter] for parameter in parameters]
    return urlencode([(name, value) for name, value in as_bytes])
