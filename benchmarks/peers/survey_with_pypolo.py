"""A survey by PyPolo, in a separate environment (it needs an older numpy than we do).

Reads one JSON document on standard input and writes one on standard output; `benchmarks/pypolo_peer.py` calls it.
Request: {"strategy": "myopic" | "active", "field_ppb": base64 of float32, "rows", "columns", "resolution_m", "start_m",
"noise_std_ppb", "noise_ppb": [...], "samples", "pilot", "seed"}; answer: {"places_m", "values_ppb", "path_m",
"mean_ppb": base64 of float32, "std_ppb": the same, "seconds"}.

The settings are those of the library's own exam of its attentive kernel: a site of 20 units, a pilot along its Bezier
curve, a boat of Dubins that senses once a second at 1 unit/s, 1000 candidates, Adam. Its boat knows no obstacles.
"""

from __future__ import annotations

import base64
import time

from answering import answer

SITE_UNITS = 20.0
CANDIDATES = 1000


def survey(request: dict) -> dict:
    import numpy as np
    import pypolo
    import torch

    began = time.perf_counter()
    rng = np.random.RandomState(request["seed"])
    torch.manual_seed(request["seed"])
    torch.set_num_threads(1)
    rows, columns, cell = request["rows"], request["columns"], request["resolution_m"]
    field = np.frombuffer(base64.b64decode(request["field_ppb"]), dtype="<f4").reshape(rows, columns).astype(float)
    noise = np.array(request["noise_ppb"])
    unit = cell * max(rows, columns) / SITE_UNITS  # m
    extent = [0.0, columns * cell / unit, 0.0, rows * cell / unit]

    def sensed(places, first):
        places = np.clip(places, 0.0, [extent[1] - 1e-9, extent[3] - 1e-9])
        at = (places * unit / cell).astype(int)
        return (field[at[:, 1], at[:, 0]] + noise[first : first + len(places)])[:, None]

    samples = request["samples"]
    places = pypolo.strategies.Bezier(extent, rng).get(num_states=request["pilot"])
    values = sensed(places, 0)
    kernel = pypolo.kernels.AK(amplitude=1.0, lengthscales=np.linspace(0.01, 0.5, 10), dim_input=2, dim_hidden=10,
                               dim_output=10)  # fmt: skip
    spread = float(values.std()) or 1.0
    model = pypolo.models.GPR(places, values, kernel, noise=max((request["noise_std_ppb"] / spread) ** 2, 1e-4))
    model.optimize(num_iter=len(places), verbose=False)
    robot = pypolo.robots.USV(init_state=np.array([*places[-1], np.pi / 2]), control_rate=10.0, max_lin_vel=1.0,
                              tolerance=0.1, sampling_rate=1.0)  # fmt: skip
    track, taken_at = [], []
    moved = robot.update

    def update(dist, action):
        before = len(robot.sampling_locations)
        moved(dist, action)
        track.append(robot.state[:2].copy())
        if len(robot.sampling_locations) > before:
            taken_at.append(len(track))

    robot.update = update
    if request["strategy"] == "myopic":
        strategy = pypolo.strategies.MyopicPlanning(extent, rng, CANDIDATES, robot)
    else:
        strategy = pypolo.strategies.ActiveSampling(extent, rng, CANDIDATES)
    while len(places) < samples:
        new = strategy.get(model=model)[: samples - len(places)]
        found = sensed(new, len(places))
        model.add_data(new, found)
        places, values = np.vstack((places, new)), np.vstack((values, found))
        model.optimize(num_iter=len(new), verbose=False)
    if request["strategy"] == "myopic":
        driven = np.array(track[: taken_at[samples - request["pilot"] - 1]])
    else:
        driven = places[request["pilot"] :]
    path = np.vstack((np.array([request["start_m"]]) / unit, places[: request["pilot"]], driven))
    x, y = (np.arange(columns) + 0.5) * cell / unit, (np.arange(rows) + 0.5) * cell / unit
    cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    parts = [model(part, noise_free=True) for part in np.array_split(cells, 50)]
    mean, std = (np.concatenate([part[k][:, 0] for part in parts]) for k in (0, 1))
    return {
        "places_m": (places * unit).tolist(),
        "values_ppb": values[:, 0].tolist(),
        "path_m": (path * unit).tolist(),
        "mean_ppb": base64.b64encode(mean.astype("<f4").tobytes()).decode(),
        "std_ppb": base64.b64encode(std.astype("<f4").tobytes()).decode(),
        "seconds": time.perf_counter() - began,
    }


if __name__ == "__main__":
    answer(survey)
