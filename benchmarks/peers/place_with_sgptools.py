"""Places and a path from SGP-Tools, in a separate environment (it needs an older numpy than we do).

Reads one JSON document on standard input and writes one on standard output; `benchmarks/sgptools_peer.py` calls it.
Request: {"task": "place", "open_m": [[x, y], ...], "start_m": [x, y], "samples": n, "budget_m": m, "kernel": {...},
"noise_variance": v, "steps": k, "seed": s}; answer: {"places_m": [[x, y], ...], "seconds": t}.
Request: {"task": "map", "places_m", "values_ppb", "rows", "columns", "resolution_m"}; answer: {"mean_ppb": base64 of
float32}: GPflow's own Gaussian process, with the hyperparameters that it finds itself.
"""

from __future__ import annotations

import base64
import json
import os
import sys
import time

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

UNITS_PER_M = 100.0
"""Length unit of the library. It subtracts the excess length of the path from a bound in nats. In metres the excess has
too little weight: a budget of 2.2 km gave a path of 5.2 km. In centimetres it keeps the budget to some per cent."""


def kernel_of(kernel: dict):
    """The kernel by its name and parameters, lengths in metres, as GPflow has it in the library's unit."""
    import gpflow

    kinds = {
        "se": gpflow.kernels.SquaredExponential,
        "matern12": gpflow.kernels.Matern12,
        "matern32": gpflow.kernels.Matern32,
        "matern52": gpflow.kernels.Matern52,
    }

    def part(name: str, of: str = ""):
        length = UNITS_PER_M * kernel[f"{of}length_scale_m"]
        return kinds[name](lengthscales=length, variance=kernel[f"{of}variance"])

    if kernel["name"] == "smooth+rough":
        return part("se", "smooth_") + part("matern12", "rough_")
    return part(kernel["name"])


def place(request: dict) -> dict:
    """The library's recommended way: k-means, a tour by OR-Tools, then descent of all places under the budget."""
    import gpflow
    import numpy as np
    import tensorflow as tf
    from sgptools.core.transformations import IPPTransform
    from sgptools.methods import ContinuousSGP
    from sgptools.utils.misc import get_inducing_pts
    from sgptools.utils.tsp import run_tsp

    np.random.seed(request["seed"])  # noqa: NPY002 - what the library draws from
    tf.random.set_seed(request["seed"])
    gpflow.config.set_default_float(np.float64)
    began = time.perf_counter()
    ground = UNITS_PER_M * np.array(request["open_m"], dtype=np.float64)
    start = UNITS_PER_M * np.array([request["start_m"]], dtype=np.float64)
    samples = request["samples"]
    first = get_inducing_pts(ground, samples)
    paths, _ = run_tsp(first, start_nodes=start, time_limit=20)
    ordered = np.asarray(paths[0])
    fixed = ordered[None, :1]
    transform = IPPTransform(num_robots=1, distance_budget=UNITS_PER_M * request["budget_m"], Xu_fixed=fixed)
    method = ContinuousSGP(
        samples,
        ground,
        kernel_of(request["kernel"]),
        request["noise_variance"],
        transform=transform,
        X_init=ordered[1 : samples + 1],
    )
    places = method.optimize(max_steps=request["steps"], optimizer="scipy.L-BFGS-B")[0]
    if len(places) == samples + 1:
        places = places[1:]
    return {"places_m": (places / UNITS_PER_M).tolist(), "seconds": time.perf_counter() - began}


def map_of(request: dict) -> dict:
    """GPflow's own exact GP, fitted as SGP-Tools fits it."""
    import gpflow
    import numpy as np
    from sgptools.utils.gpflow import get_model_params

    gpflow.config.set_default_float(np.float64)
    places = np.array(request["places_m"], dtype=np.float64)
    values = np.array(request["values_ppb"], dtype=np.float64)[:, None]
    mean, scale = values.mean(), values.std()
    *_, model = get_model_params(
        places, (values - mean) / scale, verbose=False, lengthscales=30.0, variance=1.0, noise_variance=0.05,
        return_model=True, force_gp=True,
    )  # fmt: skip
    x = (np.arange(request["columns"]) + 0.5) * request["resolution_m"]
    y = (np.arange(request["rows"]) + 0.5) * request["resolution_m"]
    cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    means = [np.asarray(model.predict_f(part)[0])[:, 0] for part in np.array_split(cells, 50)]
    field = (np.concatenate(means) * scale + mean).astype("<f4")
    return {"mean_ppb": base64.b64encode(field.tobytes()).decode()}


def main() -> int:
    request = json.load(sys.stdin)
    # What the libraries print must not get into the answer.
    answer_to = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    answer = place(request) if request["task"] == "place" else map_of(request)
    json.dump(answer, answer_to)
    answer_to.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
