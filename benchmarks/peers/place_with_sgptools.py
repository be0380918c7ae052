"""Places and a path from SGP-Tools, in a separate environment (it needs an older numpy than we do).

Reads one JSON document on standard input and writes one on standard output; `benchmarks/sgptools_peer.py` calls it.
Request: {"task": "place", "open_m": [[x, y], ...], "start_m": [x, y], "samples": n, "budget_m": m, "kernel": {...},
"noise_variance": v, "steps": k, "seed": s}; answer: {"places_m": [[x, y], ...], "seconds": t}.
Request: {"task": "explore", ..., "length_scale_m": l, "every": e, "field_ppb": base64 of float32, "rows", "columns",
"resolution_m", "noise_ppb": [...]} in place of the kernel and its noise; the same answer. The library's online way: the
hyperparameters are learned anew after every e samples, and the places that are left are moved.
Request: {"task": "map", "places_m", "values_ppb", "rows", "columns", "resolution_m", "length_scale_m"}; answer:
{"mean_ppb": base64 of float32, "std_ppb": the same}: GPflow's own Gaussian process, with the hyperparameters that it
finds itself.
"""

from __future__ import annotations

import base64
import os
import time

from answering import answer

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
    began = time.perf_counter()
    method = descent(request, kernel_of(request["kernel"]), request["noise_variance"])
    places = method.optimize(max_steps=request["steps"], optimizer="scipy.L-BFGS-B")[0]
    return {"places_m": (places[1:] / UNITS_PER_M).tolist(), "seconds": time.perf_counter() - began}


def explore(request: dict) -> dict:
    """Online: after every few samples the hyperparameters are learned anew, and the places that are left are moved."""
    import gpflow
    import numpy as np
    from sgptools.utils.gpflow import get_model_params

    began = time.perf_counter()
    shape = request["rows"], request["columns"]
    field = np.frombuffer(base64.b64decode(request["field_ppb"]), dtype="<f4").reshape(shape).astype(np.float64)
    noise = np.array(request["noise_ppb"])
    length = UNITS_PER_M * request["length_scale_m"]
    method = descent(request, gpflow.kernels.SquaredExponential(lengthscales=length, variance=1.0), 0.1)
    total, done = request["samples"] + 1, 1
    places = method.optimize(max_steps=request["steps"], optimizer="scipy.L-BFGS-B")[0]
    values = np.zeros(0)
    while done + request["every"] < total:
        upto = done + request["every"]
        cells = places[done:upto] / (UNITS_PER_M * request["resolution_m"])
        rows, columns = (np.clip(cells[:, k].astype(int), 0, shape[1 - k] - 1) for k in (1, 0))
        values = np.append(values, field[rows, columns] + noise[done - 1 : upto - 1])
        done = upto
        spread = values.std() or 1.0
        # In units of the first length, so that the optimiser's first steps suit a site of any size.
        _, learned, kernel = get_model_params(
            places[1:done] / length, ((values - values.mean()) / spread)[:, None], verbose=False, lengthscales=1.0,
            variance=1.0, noise_variance=0.1, max_steps=300,
        )  # fmt: skip
        found = length * float(kernel.lengthscales.numpy())
        kernel = gpflow.kernels.SquaredExponential(lengthscales=found, variance=kernel.variance.numpy())
        method.update(kernel, learned)
        method.transform.update_Xu_fixed(places[None, :done])
        places = method.optimize(max_steps=request["steps"], optimizer="scipy.L-BFGS-B")[0]
    return {"places_m": (places[1:] / UNITS_PER_M).tolist(), "seconds": time.perf_counter() - began}


def descent(request: dict, kernel, noise_variance: float):
    """The library's method with its first places: k-means, and a tour by OR-Tools from the start, which is fixed."""
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
    ground = UNITS_PER_M * np.array(request["open_m"], dtype=np.float64)
    start = UNITS_PER_M * np.array([request["start_m"]], dtype=np.float64)
    samples = request["samples"]
    paths, _ = run_tsp(get_inducing_pts(ground, samples), start_nodes=start, time_limit=20)
    ordered = np.asarray(paths[0])
    budget = UNITS_PER_M * request["budget_m"]
    # The start is no sample: the library keeps it as the first place, beside the samples.
    transform = IPPTransform(num_robots=1, distance_budget=budget, Xu_fixed=ordered[None, :1])
    return ContinuousSGP(
        samples + 1, ground, kernel, noise_variance, transform=transform, X_init=ordered[: samples + 1]
    )


def map_of(request: dict) -> dict:
    """GPflow's own exact GP, fitted as SGP-Tools fits it."""
    import gpflow
    import numpy as np
    from sgptools.utils.gpflow import get_model_params

    gpflow.config.set_default_float(np.float64)
    places = np.array(request["places_m"], dtype=np.float64)
    values = np.array(request["values_ppb"], dtype=np.float64)[:, None]
    mean, scale = values.mean(), values.std() or 1.0
    unit = request["length_scale_m"]  # in metres the optimiser's first steps do not suit a site of kilometres
    *_, model = get_model_params(
        places / unit, (values - mean) / scale, verbose=False, lengthscales=1.0, variance=1.0,
        noise_variance=0.05, return_model=True, force_gp=True,
    )  # fmt: skip
    x = (np.arange(request["columns"]) + 0.5) * request["resolution_m"]
    y = (np.arange(request["rows"]) + 0.5) * request["resolution_m"]
    cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    parts = [model.predict_f(part / unit) for part in np.array_split(cells, 50)]
    means, variances = (np.concatenate([np.asarray(part[k])[:, 0] for part in parts]) for k in (0, 1))
    field, std = means * scale + mean, np.sqrt(np.maximum(variances, 1e-12)) * scale
    return {key: base64.b64encode(array.astype("<f4").tobytes()).decode()
            for key, array in (("mean_ppb", field), ("std_ppb", std))}  # fmt: skip


def asked(request: dict) -> dict:
    return {"place": place, "explore": explore, "map": map_of}[request["task"]](request)


if __name__ == "__main__":
    answer(asked)
