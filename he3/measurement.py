"""The sensor noise of a measurement, a pure function of the mission's seed and the sample's id.

y = f(x) + e with e ~ N(0, sigma^2). A repeated request for a sample returns the same noise, also after a restart;
different ids or seeds give independent noise.
"""

from __future__ import annotations

import hashlib

import numpy as np

from he3.errors import InvalidInput


def sample_noise(seed: int, sample_id: str, std: float) -> float:
    """The noise of a sample, in the unit of ``std``: one draw from N(0, std^2), fixed by seed and id.

    Raises InvalidInput if std is not a finite number of at least 0.
    """
    if not 0 <= std < float("inf"):
        raise InvalidInput(f"expected a noise standard deviation of at least 0, got {std}")
    # Python's hash of a string differs between processes; a digest does not.
    digest = hashlib.blake2b(f"{seed}:{sample_id}".encode(), digest_size=16, person=b"he3-noise").digest()
    stream = np.random.Generator(np.random.Philox(key=int.from_bytes(digest, "little")))
    return std * float(stream.standard_normal())
