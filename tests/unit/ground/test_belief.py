"""The belief: the map depends on the samples alone."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from he3.errors import InvalidInput, OutsideRegion
from he3.frames import SiteGrid
from he3.gp import GaussianProcess
from he3.hyperparameters import Hyperparameters
from he3.kernels import AUTO, KERNELS, Kernel, Stretched
from he3.local_amplitude import LocalAmplitude, LocallyScaled, modes
from he3.mixture import ProcessMixture
from he3.trend import CovariateTrend, orbital_trend
from he3.warping import Warp
from services.ground.belief import Belief
from services.ground.fitting import due, fit, fit_kernel
from services.ground.observation import Observation
from services.ground.state_types import STATE_TYPES
from services.runtime.state_codec import StateCodec

GRID = SiteGrid(40, 50)
NOISE = 0.1


def observations(count: int, seed: int = 4) -> dict[str, Observation]:
    rng = np.random.default_rng(seed)
    places = rng.uniform((0, 0), (50, 40), (count, 2))
    values = 8 + np.sin(places[:, 0] / 8) + 0.1 * rng.normal(size=count)
    return {
        f"s{i}": Observation((1 + i // 5, 1, i % 5), (float(x), float(y)), float(value))
        for i, ((x, y), value) in enumerate(zip(places, values, strict=True))
    }


def belief_of(samples: dict[str, Observation], kernel: str = "matern52", trend: CovariateTrend | None = None) -> Belief:
    belief = Belief(GRID, kernel, NOISE, trend)
    for name, observation in samples.items():
        belief.add(name, observation)
    return belief


def fit_of(belief: Belief) -> Hyperparameters:
    request = belief.fit_request(9, (1, 9))
    assert request is not None
    return fit(request)


def refit(belief: Belief, up_to_round: int) -> None:
    request = belief.fit_request(up_to_round, (1, up_to_round))
    assert request is not None
    belief.adopt(fit(pickle.loads(pickle.dumps(request))))


def test_before_any_sample_the_map_is_the_prior_of_lunar_soils() -> None:
    empty = Belief(GRID, "se", NOISE).map
    assert (empty.mean_ppb == 7.5).all()
    assert (empty.std_ppb > 4.0).all()  # of the sites' means, and then the field's own
    likeliest = Belief(GRID, "se", NOISE, likeliest=True).map
    assert (likeliest.mean_ppb == 7.5).all()
    assert (likeliest.std_ppb == 4.0).all()


def test_a_belief_that_is_read_now_and_then_is_the_same_to_the_bit_when_it_is_read() -> None:
    followed, asked = Belief(GRID, "matern52", NOISE), Belief(GRID, "matern52", NOISE, followed=False)
    for number, (name, observation) in enumerate(observations(12).items()):
        for belief in (followed, asked):
            belief.add(name, observation)
            if number == 6:
                belief.adopt(replace(belief.hyperparameters, kernel=KERNELS["matern52"](1.0, 20.0)))
    np.testing.assert_array_equal(asked.process.whitened, followed.process.whitened)
    np.testing.assert_array_equal(asked.process.factor, followed.process.factor)
    np.testing.assert_array_equal(asked.map.std_ppb, followed.map.std_ppb)


def test_each_sample_is_in_the_map_at_once_and_exactly() -> None:
    samples = observations(12)
    belief = belief_of(samples)
    process = GaussianProcess(belief.hyperparameters).condition(
        [o.place_m for o in samples.values()], [o.value_ppb for o in samples.values()]
    )
    mean, std = ProcessMixture.of(process).predict(GRID.points())
    assert np.allclose(belief.map.mean_ppb.ravel(), mean, atol=2e-4)
    assert np.allclose(belief.map.std_ppb.ravel(), std, atol=2e-3)


def test_a_sample_that_is_there_already_changes_nothing() -> None:
    samples = observations(6)
    belief = belief_of(samples)
    before = belief.map
    assert not belief.add("s3", samples["s3"])
    assert belief.map is before
    assert len(belief) == 6


@pytest.mark.parametrize(
    ("observation", "error"),
    [
        (Observation((1, 1, 0), (51.0, 3.0), 8.0), OutsideRegion),
        (Observation((1, 1, 0), (5.0, 3.0), 1e7), InvalidInput),
        (Observation((1, 1, 0), (5.0, 3.0), float("nan")), InvalidInput),
    ],
)
def test_an_impossible_sample_is_refused_and_changes_nothing(observation: Observation, error: type[Exception]) -> None:
    belief = belief_of(observations(3))
    before = belief.map
    with pytest.raises(error):
        belief.add("bad", observation)
    assert belief.map is before
    assert "bad" not in belief


def test_the_map_of_all_samples_is_the_same_to_the_byte_whatever_the_order_of_arrival() -> None:
    samples = observations(20)
    names = list(samples)
    shuffled = [names[i] for i in np.random.default_rng(9).permutation(20)]
    in_order, mixed = belief_of(samples), belief_of({name: samples[name] for name in shuffled})
    for belief in (in_order, mixed):
        for number in range(1, 5):
            refit(belief, number)
    assert in_order.map.mean_ppb.tobytes() == mixed.map.mean_ppb.tobytes()
    assert in_order.map.std_ppb.tobytes() == mixed.map.std_ppb.tobytes()


def test_a_refit_sees_the_rounds_up_to_its_own_and_no_others() -> None:
    belief = belief_of(observations(20))
    request = belief.fit_request(2, (1, 2))
    assert request is not None
    assert len(request.values_ppb) == 10
    assert belief_of(observations(10)).fit_request(2, (1, 2)) is not None
    assert np.array_equal(request.xy_m, belief_of(observations(20)).places_m[:10])


def test_the_map_of_a_wide_region_learns_a_length_scale_longer_than_500_m() -> None:
    wide = SiteGrid(50, 60, 150.0)
    x, y = np.meshgrid(wide.x_m, wide.y_m)
    truth = 8.0 + np.sin(x / 2500) + np.cos(y / 2000)
    rng = np.random.default_rng(2)
    belief = Belief(wide, "matern52", NOISE)
    for i, (place_x, place_y) in enumerate(rng.uniform((0, 0), (wide.width_m, wide.height_m), (40, 2))):
        value = 8.0 + np.sin(place_x / 2500) + np.cos(place_y / 2000)
        belief.add(f"s{i}", Observation((1 + i // 5, 1, i % 5), (float(place_x), float(place_y)), float(value)))
    refit(belief, 8)
    assert belief.hyperparameters.kernel.parameters()["length_scale_m"] > 1000
    assert float(np.sqrt(np.mean((belief.map.mean_ppb - truth) ** 2))) < 0.25 * float(truth.std())


def test_honest_readings_of_a_noisy_instrument_are_all_taken_whatever_their_sign() -> None:
    noise_ppb = 1000.0
    belief = Belief(GRID, "matern52", noise_ppb)
    for number, value in enumerate(np.random.default_rng(3).normal(8.0, noise_ppb, 40)):
        belief.add(f"s{number}", Observation((1, 1, number), (float(number) + 0.5, 10.0), float(value)))
    assert len(belief) == 40
    with pytest.raises(InvalidInput, match=r"expected -10000 to 1\.01e\+06 ppb, got -10001"):
        belief.add("low", Observation((1, 1, 40), (1.0, 1.0), -10_001.0))


def test_without_a_sample_there_is_nothing_to_fit() -> None:
    assert Belief(GRID, "se", NOISE).fit_request(1, (1,)) is None


@pytest.mark.parametrize("kernel", [*KERNELS, AUTO])
def test_every_kernel_of_a_scenario_is_fitted_and_keeps_the_likelihood_or_betters_it(kernel: str) -> None:
    belief = Belief(GRID, kernel, NOISE, likeliest=True)
    for name, observation in observations(20).items():
        belief.add(name, observation)
    refit(belief, 4)
    first = belief.hyperparameters.log_likelihood
    refit(belief, 4)
    assert belief.hyperparameters.log_likelihood >= first - 1e-6
    assert kernel in (belief.hyperparameters.kernel.name, "auto")


@pytest.mark.parametrize("kernel", [*KERNELS, AUTO])
def test_every_kernel_of_a_scenario_has_most_probable_parameters_the_same_for_the_same_samples(kernel: str) -> None:
    belief = belief_of(observations(20), kernel)
    request = belief.fit_request(4, (1,))
    assert request is not None
    fitted = fit(request)
    assert kernel in (fitted.kernel.name, AUTO)
    assert np.isfinite(fitted.log_likelihood)
    assert fit(request) == fitted


def test_an_orbital_prior_is_the_map_before_the_first_sample_and_survives_a_refit() -> None:
    x, _ = np.meshgrid(GRID.x_m, GRID.y_m)
    orbital = 6.0 + 0.05 * x
    belief = Belief(GRID, "matern52", NOISE, orbital_trend(GRID, orbital))
    assert np.allclose(belief.map.mean_ppb, orbital, atol=1e-5)
    for name, observation in observations(10).items():
        belief.add(name, observation)
    request = belief.fit_request(2, (1,))
    assert request is not None
    fitted = fit(request)
    assert fitted.trend is None  # the belief has it, and it is large
    belief.adopt(fitted)
    assert belief.hyperparameters.trend is not None
    assert len(belief) == 10


def test_a_map_that_is_asked_for_once_is_to_the_byte_the_one_that_was_asked_for_after_each_sample() -> None:
    fitted = fit_of(belief_of(observations(10)))
    watched, asked = Belief(GRID, "matern52", NOISE), Belief(GRID, "matern52", NOISE)
    for number, (name, observation) in enumerate(observations(14).items()):
        for belief in (watched, asked):
            if number == 10:
                belief.adopt(fitted)
            belief.add(name, observation)
        assert watched.map.samples == number + 1
    assert watched.changes == asked.changes == 15
    np.testing.assert_array_equal(asked.map.mean_ppb, watched.map.mean_ppb)
    np.testing.assert_array_equal(asked.map.std_ppb, watched.map.std_ppb)
    np.testing.assert_array_equal(asked.process.factor, watched.process.factor)


UNEVEN = LocallyScaled(
    KERNELS["matern12"](), LocalAmplitude(GRID.extent_m, tuple(0.1 * j - 0.2 * k for j, k in modes()))
)


@pytest.mark.parametrize(
    "kernel", [*(kind() for kind in KERNELS.values()), Stretched(KERNELS["se"](), 2.0, 40.0), UNEVEN],
    ids=lambda kernel: f"{type(kernel).__name__}",
)  # fmt: skip
def test_a_mixture_with_any_kernel_is_kept_and_restored(kernel: Kernel) -> None:
    """The journal keeps the result of a fit before the node sees it, and a checkpoint the belief that adopted it."""
    belief, restored = belief_of(observations(10)), Belief(GRID, "matern52", NOISE)
    codec = StateCodec(STATE_TYPES)
    plain = belief.hyperparameters.kernel
    fitted = replace(belief.hyperparameters, alternatives=((0.5, plain), (0.5, kernel)), log_likelihood=-1.0)
    assert codec.decode(codec.encode(fitted)) == fitted
    belief.adopt(fitted)
    restored.restore(codec.decode(codec.encode(belief.checkpoint())))
    assert restored.hyperparameters == belief.hyperparameters
    np.testing.assert_array_equal(restored.map.std_ppb, belief.map.std_ppb)


def test_a_mixture_with_warps_is_kept_and_restored_with_its_map_and_intervals() -> None:
    belief, restored = belief_of(observations(10)), Belief(GRID, "matern52", NOISE)
    codec = StateCodec(STATE_TYPES)
    kernel, warp = belief.hyperparameters.kernel, Warp(8.0, 1.0, 1.0, 0.3, NOISE)
    fitted = replace(
        belief.hyperparameters, alternatives=((0.5, kernel), (0.5, kernel)), warps=(None, warp), log_likelihood=-1.0
    )
    assert codec.decode(codec.encode(fitted)) == fitted
    belief.adopt(fitted)
    belief.add("late", Observation((9, 1, 1), (20.0, 20.0), 8.0))
    ends = belief.interval_ends()
    assert ends is not None
    restored.restore(codec.decode(codec.encode({**belief.checkpoint(), "map": None})))
    assert restored.hyperparameters == belief.hyperparameters
    np.testing.assert_array_equal(restored.map.mean_ppb, belief.map.mean_ppb)
    np.testing.assert_array_equal(restored.map.std_ppb, belief.map.std_ppb)
    np.testing.assert_array_equal(restored.interval_ends(), ends)


def test_the_intervals_of_a_restored_belief_are_those_before_also_with_samples_since_the_last_fit() -> None:
    belief, restored = belief_of(observations(10)), Belief(GRID, "matern52", NOISE)
    kernels = belief.hyperparameters.kernel, Stretched(KERNELS["se"](), 2.0, 40.0)
    belief.adopt(replace(belief.hyperparameters, alternatives=((0.5, kernels[0]), (0.5, kernels[1]))))
    fitted = belief.interval_ends()
    belief.add("late", Observation((9, 1, 1), (20.0, 20.0), 8.0))
    ends = belief.interval_ends()
    assert fitted is not None
    assert ends is not None
    assert not np.array_equal(ends, fitted)
    restored.restore(belief.checkpoint())
    np.testing.assert_array_equal(restored.interval_ends(), ends)


def test_a_state_without_its_map_restores_the_same_map() -> None:
    belief, restored = belief_of(observations(10)), Belief(GRID, "matern52", NOISE)
    belief.adopt(fit_of(belief))
    belief.add("late", Observation((9, 1, 1), (20.0, 20.0), 8.0))
    restored.restore({**belief.checkpoint(), "map": None})
    np.testing.assert_array_equal(restored.map.std_ppb, belief.map.std_ppb)


def test_a_map_on_coarser_cells_has_the_mean_standard_deviation_of_the_whole_but_for_a_hundredth() -> None:
    samples = observations(10)
    whole, coarse = belief_of(samples), Belief(GRID, "matern52", NOISE, most_cells=300)
    for name, observation in samples.items():
        coarse.add(name, observation)
    assert coarse.map.std_ppb.shape == GRID.shape
    assert coarse.map.std_ppb.mean() == pytest.approx(whole.map.std_ppb.mean(), rel=0.01)
    assert np.abs(coarse.map.mean_ppb - whole.map.mean_ppb).max() < 0.5


def test_planners_are_guided_by_the_likeliest_kernel_unless_the_samples_are_too_equal_for_it() -> None:
    varied = belief_of(observations(20))
    request = varied.fit_request(4, (1,))
    assert request is not None
    likeliest, fitted = fit(replace(request, prior=None)), fit(request)
    assert fitted.field_std_ppb == pytest.approx(likeliest.field_std_ppb)
    assert fitted.alternatives
    equal = fit(replace(request, values_ppb=np.full(20, 8.0)))
    assert fit(replace(request, values_ppb=np.full(20, 8.0), prior=None)).field_std_ppb < 0.1 < equal.field_std_ppb


def test_a_fit_of_the_one_kernel_has_the_kernel_of_the_whole_fit_and_the_alternatives_of_the_one_before() -> None:
    belief = belief_of(observations(20))
    first = belief.fit_request(2, (1,))
    assert first is not None
    belief.adopt(fit(first))
    request = belief.fit_request(4, (1,))
    assert request is not None
    whole, kernel_alone = fit(request), fit_kernel(request)
    assert kernel_alone.alternatives == belief.hyperparameters.alternatives != whole.alternatives
    places = [(0.0, 0.0), (3.0, 4.0), (20.0, 1.0)]
    covariances = [each.scale_ppb**2 * each.kernel.covariance(places, places) for each in (whole, kernel_alone)]
    np.testing.assert_allclose(*covariances, rtol=1e-3)
    for lacks in (replace(request, prior=None), replace(request, values_ppb=np.full(20, 8.0))):
        assert fit_kernel(lacks) == fit(lacks)
    assert fit(replace(request, whole=False)) == kernel_alone


def test_alternatives_are_inferred_after_every_round_of_few_samples_and_from_all_at_the_end() -> None:
    inferred = [0]
    for samples in range(5, 151, 5):
        if due(samples, inferred[-1], 150):
            inferred.append(samples)
    assert inferred[1:] == [5, 10, 15, 20, 25, 35, 45, 60, 75, 95, 120, 150]
    assert due(33, 30, 33)


def test_before_the_first_sample_auto_mixes_kernels_and_plans_with_the_most_cautious() -> None:
    known = Belief(GRID, AUTO, NOISE).hyperparameters
    assert known.kernel == Belief(GRID, "smooth+rough", NOISE).hyperparameters.kernel
    assert len(known.alternatives) > 1
    assert Belief(GRID, AUTO, NOISE, likeliest=True).hyperparameters.kernel.name == "matern52"
