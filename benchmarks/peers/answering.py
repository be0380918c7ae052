"""One JSON document in, one out: how every script of this folder is asked and answers."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from typing import Any


def answer(function: Callable[[dict], Any]) -> None:
    """Write what the function makes of the request on standard input to standard output."""
    request = json.load(sys.stdin)
    # What the libraries print must not get into the answer.
    answer_to = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    json.dump(function(request), answer_to)
    answer_to.close()
