"""The separate environments of other planning software, and the scripts that run in them.

They need older versions of packages than we do. A script of `benchmarks/peers` reads one JSON document on standard
input and writes one on standard output.
"""

from __future__ import annotations

import base64
import json
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from he3.errors import He3Error, InvalidInput
from he3.frames import FloatArray

PEERS = Path(__file__).parent / "peers"
CHECKOUT = Path(__file__).parent.parent
TIMEOUT_S = 3600


@dataclass(frozen=True, slots=True)
class PeerEnvironment:
    """An environment with another software, and the script that asks it."""

    software: str
    script: str
    requirements: str
    folder: str
    variable: str
    """Environment variable that names another interpreter."""

    def python(self) -> Path:
        """The interpreter; raises InvalidInput, with instructions, if there is none."""
        path = Path(os.environ.get(self.variable, CHECKOUT / self.folder / "bin" / "python"))
        if not path.is_file():
            raise InvalidInput(
                f"{self.software} needs a separate environment, expected its interpreter at {path}, found none; make "
                f"it with 'python3 -m venv {self.folder} && {self.folder}/bin/pip install -r "
                f"benchmarks/peers/{self.requirements}' or name one in {self.variable}"
            )
        return path

    @property
    def installed(self) -> bool:
        """Whether there is an interpreter."""
        try:
            self.python()
        except InvalidInput:
            return False
        return True

    def ask(self, request: dict[str, Any]) -> Any:
        """The script's answer; raises He3Error if it fails."""
        done = subprocess.run(
            [self.python(), PEERS / self.script],
            input=json.dumps(request),
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["nothing"])[-1]
            raise He3Error(f"{self.software} ended with {done.returncode}, saying: {last}")
        return json.loads(done.stdout)


SGPTOOLS = PeerEnvironment("SGP-Tools", "place_with_sgptools.py", "requirements.txt", ".venv-peers", "HE3_PEERS_PYTHON")
SGPTOOLS_COVERS = PeerEnvironment(
    "SGP-Tools", "cover_with_sgptools.py", "requirements.txt", ".venv-peers", "HE3_PEERS_PYTHON"
)
PYPOLO = PeerEnvironment(
    "PyPolo", "survey_with_pypolo.py", "requirements-pypolo.txt", ".venv-pypolo", "HE3_PYPOLO_PYTHON"
)


def packed(array: NDArray[np.floating]) -> str:
    """The array as text: base64 of little-endian float32."""
    return base64.b64encode(np.asarray(array, dtype="<f4").tobytes()).decode()


def unpacked(text: str, shape: tuple[int, int]) -> FloatArray:
    """The array (rows, columns) of such a text."""
    return np.frombuffer(base64.b64decode(text), dtype="<f4").reshape(shape).astype(np.float64)
