"""The fit of the hyperparameters, as a function that runs in another process."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from he3.hyperparameters import Hyperparameters, fit_hyperparameters
from he3.hyperposterior import hyperparameter_draws, infer_hyperparameters

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from he3.hyperposterior import HyperparameterDraws
    from he3.hyperprior import Hyperprior
    from he3.trend import CovariateTrend


@dataclass(frozen=True, slots=True)
class FitRequest:
    """The input of a refit: places (n, 2) [m], values (n,) [ppb], previous hyperparameters, extent of the site [m].

    prior: of the hyperparameters; None for those of maximum likelihood. whole: whether the alternatives are inferred
    too, or kept as they were. nearby: whether the one kernel is searched from the previous one alone.
    """

    xy_m: FloatArray
    values_ppb: FloatArray
    kernel: str
    noise_std_ppb: float
    previous: Hyperparameters | None
    trend: CovariateTrend | None
    seed: tuple[int, ...]
    extent_m: float
    prior: Hyperprior | None = None
    whole: bool = True
    nearby: bool = False


MORE_SAMPLES = 1.25  # 1, ratio of the samples from which alternatives are inferred and those of the time before


def due(samples: int, inferred_from: int, all_samples: int) -> bool:
    """Whether the alternatives are to be inferred again, if they were last inferred from so many samples.

    That takes ten times as long as to fit the one kernel, and they hardly change with a few more samples. They are
    inferred from all samples at the end of the mission.
    """
    return samples >= min(MORE_SAMPLES * inferred_from, all_samples)


def fit(request: FitRequest) -> Hyperparameters:
    """The hyperparameters, without the request's trend, which the caller has. Pure and picklable.

    With a prior, their alternatives stand for all that the samples leave possible. The one kernel is that of maximum
    likelihood, with which the designs of `tour` are best, unless the field would vary by less than the prior allows,
    as it would after a few equal samples; then it is the most probable one.
    """
    if request.prior is None:
        return replace(_likeliest(request, request.kernel, request.noise_std_ppb), trend=None)
    return _inferred(request, request.prior) if request.whole else fit_kernel(request)


def draws(request: FitRequest) -> HyperparameterDraws | None:
    """The posterior of the hyperparameters to draw from, without the request's trend; None without a prior."""
    if request.prior is None:
        return None
    found = hyperparameter_draws(
        request.xy_m,
        request.values_ppb,
        request.kernel,
        request.prior,
        noise_std_ppb=request.noise_std_ppb,
        trend=request.trend,
        previous=request.previous,
    )
    return found if request.trend is None else replace(found, fitted=replace(found.fitted, trend=None))


def infer(request: FitRequest, prior: Hyperprior) -> Hyperparameters:
    """The alternatives inferred anew, and the most probable kernel among them, without the request's trend.

    The map under the alternatives does not depend on the one kernel, which is all that `fit` adds.
    """
    inferred = _alternatives(request, prior)
    return inferred if request.trend is None else replace(inferred, trend=None)


def _alternatives(request: FitRequest, prior: Hyperprior) -> Hyperparameters:
    return infer_hyperparameters(
        request.xy_m,
        request.values_ppb,
        request.kernel,
        prior,
        noise_std_ppb=request.noise_std_ppb,
        trend=request.trend,
        previous=request.previous,
    )


def _inferred(request: FitRequest, prior: Hyperprior) -> Hyperparameters:
    """The hyperparameters, their alternatives inferred anew."""
    inferred = _alternatives(request, prior)
    if len(request.xy_m):
        likeliest = _likeliest(request, inferred.kernel.name, inferred.noise_std_ppb, inferred.trend_shares)
        if likeliest.field_std_ppb >= prior.least_field_std_ppb:
            inferred = inferred.with_kernel_of(likeliest)
    return inferred if request.trend is None else replace(inferred, trend=None)


def fit_kernel(request: FitRequest) -> Hyperparameters:
    """As `fit`, but with the alternatives and the kind of kernel of the fit before.

    It takes a tenth of the time. The kernel is that of `fit` but for rounding, and for what was learned of the noise
    since the fit before.
    """
    previous, prior = request.previous, request.prior
    if prior is None:
        return fit(request)
    if previous is None or not previous.alternatives:
        return _inferred(request, prior)
    likeliest = _likeliest(request, previous.kernel.name, previous.noise_std_ppb, previous.trend_shares)
    if likeliest.field_std_ppb < prior.least_field_std_ppb:
        return _inferred(request, prior)
    fitted = previous.with_kernel_of(likeliest)
    return fitted if request.trend is None else replace(fitted, trend=None)


def _likeliest(
    request: FitRequest, kernel: str, noise_std_ppb: float, trend_shares: tuple[float, ...] = ()
) -> Hyperparameters:
    """The hyperparameters of maximum likelihood."""
    return fit_hyperparameters(
        request.xy_m,
        request.values_ppb,
        kernel,
        rng=np.random.default_rng(np.random.SeedSequence(request.seed)),
        noise_std_ppb=noise_std_ppb,
        previous=request.previous,
        trend=request.trend,
        trend_shares=trend_shares,
        extent_m=request.extent_m,
        nearby=request.nearby,
    )
