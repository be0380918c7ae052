"""What operators see of the hyperparameters are the hyperparameters."""

from __future__ import annotations

from dataclasses import replace

from he3.gp import Hyperparameters
from he3.kernels import Matern12, Matern32, SmoothPlusRough, Stretched
from he3.local_amplitude import LocalAmplitude, LocallyScaled, modes
from he3.trend import UnknownConstant, UnknownLevel
from he3.warping import Warp
from schemas.ground import KernelParameters
from services.ground.map.overview import hyperparameters_from, kernel_parameters

PLAIN = ((0.75, Matern32(1.0, 60.0)), (0.25, Matern32(0.2, 150.0)))
ALTERNATIVES = ((0.75, Matern32(1.0, 60.0)), (0.25, Stretched(Matern32(0.2, 150.0), 3.0, 120.0)))
FAMILIES = ((0.5, Matern32(1.0, 60.0)), (0.3, SmoothPlusRough()), (0.2, Stretched(Matern12(0.2, 150.0), 3.0, 120.0)))


def seen(hyperparameters: Hyperparameters) -> Hyperparameters:
    """As an operator has them from a message."""
    message = kernel_parameters(hyperparameters).model_dump_json()
    return hyperparameters_from(KernelParameters.model_validate_json(message))


def test_an_operator_sees_every_kernel_with_its_lengths_and_noise() -> None:
    trend = UnknownConstant(4.0)
    for alternatives, noises in ((PLAIN, ()), (ALTERNATIVES, (0.1, 0.35)), (FAMILIES, ()), ((), ())):
        own = Hyperparameters(
            Matern32(0.8, 70.0), 0.2, 7.5, 1.5, trend=trend, alternatives=alternatives, noises_ppb=noises
        )
        assert kernel_parameters(seen(own)) == kernel_parameters(own)
        assert seen(own).alternatives == alternatives
        assert seen(own).noises_ppb == noises


def test_an_operator_sees_the_warp_of_each_kernel() -> None:
    warp = Warp(8.0, 2.0, -1.0, 0.3, 0.1)
    for alternatives, noises in ((PLAIN, ()), (ALTERNATIVES, (0.1, 0.35))):
        own = Hyperparameters(
            Matern32(0.8, 70.0), 0.2, 7.5, 1.5, trend=UnknownConstant(4.0), alternatives=alternatives,
            noises_ppb=noises, warps=(None, warp),
        )  # fmt: skip
        assert seen(own) == replace(own, log_likelihood=seen(own).log_likelihood)
    assert "warp" not in kernel_parameters(replace(own, warps=())).model_dump_json()


def test_an_operator_sees_where_a_field_varies_more() -> None:
    amplitude = LocalAmplitude(500.0, tuple(0.1 * j - 0.3 * k for j, k in modes()))
    uneven = tuple((weight, LocallyScaled(kernel, amplitude)) for weight, kernel in ALTERNATIVES)
    own = Hyperparameters(Matern32(0.8, 70.0), 0.2, 7.5, 1.5, trend=UnknownConstant(4.0), alternatives=uneven)
    assert seen(own) == replace(own, log_likelihood=seen(own).log_likelihood)


def test_an_operator_sees_how_the_level_varies() -> None:
    own = Hyperparameters(Matern32(0.8, 7000.0), 0.2, 7.5, 1.5, trend=UnknownLevel(4.0, 30_000.0))
    assert seen(own).trend == own.trend


def test_an_operator_sees_how_much_room_each_layer_has() -> None:
    own = Hyperparameters(Matern32(0.8, 70.0), 0.2, 7.5, 1.5, trend_shares=(3.5, 0.0))
    assert seen(own).trend_shares == own.trend_shares
