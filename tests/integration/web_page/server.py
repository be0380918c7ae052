"""The page's server as a process, and requests to it without a browser."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

from services.console.client.mission_client import MissionClient
from tests.processes import start
from tests.waiting import PATIENCE_S, until

RATE = 60.0
BROWSER = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
"""Keeps the session of each server that was logged in to."""
OUR_PAGE = {"content-type": "application/json", "x-he3-console": "1"}


class Served:
    """The page's server as a process; gives its address."""

    def __init__(self, mission: MissionClient, *flags: str) -> None:
        self._login_file = Path(flags[flags.index("--login-file") + 1]) if "--login-file" in flags else None
        self._command = [
            sys.executable, "-m", "services.console", "web", "--port", "0", *flags,
            "--mission", mission.mission, "--earth", mission.earth,
        ]  # fmt: skip

    def __enter__(self) -> str:
        self.process = start(self._command, stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        line = self.process.stderr.readline()
        if "INSECURE" in line:
            line = self.process.stderr.readline()
        if self._login_file is not None:
            line = self._login_file.read_text()
        found = re.search(r"(https?://[^/]+/)(login[^\s,]+)?", line)
        assert found is not None, line
        self.login = found[0]
        if found[2] is not None and found[1].startswith("http:"):
            get(self.login)
        if found[1].startswith("http:"):
            until(lambda: get(f"{found[1]}api/map/point?x=1&y=1")[0] == 200, "an answer from the ground")
        return found[1]

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        if self.process.stderr is not None:
            self.process.stderr.close()


def get(url: str, headers: dict[str, str] | None = None, document: object = None) -> tuple[int, bytes]:
    body = None if document is None else json.dumps(document).encode()
    request = urllib.request.Request(url, data=body, headers=headers or {})
    try:
        with BROWSER.open(request, timeout=PATIENCE_S) as response:
            return response.status, response.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()
    except urllib.error.URLError:
        return 0, b""


def post(opener: urllib.request.OpenerDirector, own: str, path: str, document: object) -> int:
    request = urllib.request.Request(
        f"{own}/api/{path}", data=json.dumps(document).encode(), headers={**OUR_PAGE, "origin": own}
    )
    return opened(opener, request)[0]


def opened(opener: urllib.request.OpenerDirector, what: str | urllib.request.Request) -> tuple[int, bytes]:
    """Status and body of the answer; of a stream, what has come so far."""
    try:
        with opener.open(what, timeout=PATIENCE_S) as response:
            return response.status, response.read(100_000)
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()
