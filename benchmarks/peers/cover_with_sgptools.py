"""Covers from SGP-Tools' coverage planners, in a separate environment; `benchmarks/covers.py` calls it.

Reads one JSON document on standard input and writes one on standard output. Request: {"objective_m": [[x, y], ...],
"start_m": [x, y], "variance": v, "length_scale_m": l, "noise_variance": n, "designs": [{"method": "HexCover",
"threshold": t}, ...]}; the kernel is a squared exponential, for which HexCover's radius is derived. Answer:
[{"places_m": [[x, y], ...], "seconds": t} or {"why": "..."}, ...], the places in the library's own order.
"""

from __future__ import annotations

import os
import time

from answering import answer

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
MOST_PLACES = 5000


def designs(request: dict) -> list[dict]:
    """The designs in their order; one that the library does not find has its reason."""
    import gpflow
    import numpy as np
    from sgptools.methods import get_method

    gpflow.config.set_default_float(np.float64)
    kernel = gpflow.kernels.SquaredExponential(lengthscales=request["length_scale_m"], variance=request["variance"])
    ground = np.array(request["objective_m"], dtype=np.float64)
    start = np.array([request["start_m"]], dtype=np.float64)
    found = []
    for design in request["designs"]:
        began = time.perf_counter()
        method = get_method(design["method"])(MOST_PLACES, ground, kernel, request["noise_variance"])
        try:
            places = method.optimize(post_var_threshold=design["threshold"], start_nodes=start)[0]
        except ValueError as error:
            found.append({"why": " ".join(str(error).split())[:200]})
            continue
        kept = np.hypot(*(places - start[0]).T) > 0.0  # some of the methods return the start, too
        found.append({"places_m": places[kept].tolist(), "seconds": time.perf_counter() - began})
    return found


if __name__ == "__main__":
    answer(designs)
