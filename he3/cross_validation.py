"""Leave-one-out cross-validation: each sample as all the others predict it, in closed form.

It is the check of a map that needs no reference field. With the hyperparameters and the weights of the mixture as they
are given all samples, the prediction of sample i from the others has in each process of the mixture the mean and
variance of ``he3.kernel_families.left_out`` (Rasmussen & Williams 2006, sect. 5.4.2), measurement noise included. Of
the mixture's distribution F_i of that prediction, the score

    u_i = Phi^-1(F_i(y_i))

is standard normal if the belief is honest: it lies within -1 and 1 in 68.3 % of all samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from he3.intervals import NORMAL_ENDS
from he3.kernel_families import left_out
from he3.mixture import ProcessMixture, mixture_moments
from he3.tails import interval_levels, normal_scores

if TYPE_CHECKING:
    from he3.frames import FloatArray
    from he3.gp import GaussianProcess


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidation:
    """Each of n samples as the others predict it. Arrays (n,), in the order of the samples."""

    measured_ppb: FloatArray
    expected_ppb: FloatArray
    """Mean of the prediction."""
    std_ppb: FloatArray
    """Standard deviation of the prediction, measurement noise included."""
    scores: FloatArray
    """Where the measured value lies in the prediction, in standard deviations of a normal distribution; 6 at most."""
    levels: tuple[float, float]
    """Scores at which the map's intervals of 68.3 and 95.4 % end: 1 and 2 unless the samples show other tails."""

    def __len__(self) -> int:
        return len(self.scores)

    @property
    def rmse_ppb(self) -> float:
        """Root mean square of measured less expected value."""
        return float(np.sqrt(np.mean((self.measured_ppb - self.expected_ppb) ** 2)))

    @property
    def bias_ppb(self) -> float:
        """Mean of measured less expected value."""
        return float(np.mean(self.measured_ppb - self.expected_ppb))

    @property
    def score_rms(self) -> float:
        """Root mean square of the scores: 1 if the belief is honest, more if it is too certain."""
        return float(np.sqrt(np.mean(self.scores**2)))

    @property
    def within(self) -> tuple[float, float]:
        """Shares of the samples within the map's intervals of 68.3 and 95.4 %."""
        away = np.abs(self.scores)
        return float(np.mean(away <= self.levels[0])), float(np.mean(away <= self.levels[1]))


def cross_validate(process: GaussianProcess) -> CrossValidation:
    """Leave-one-out cross-validation of the belief's mixture, or of the one process if it has no alternatives.

    process: given at least one sample. It takes O(n^3) operations for each process of the mixture.
    """
    mixture, count = ProcessMixture.of(process), len(process)
    found = np.array([left_out(one.factor, one.whitened) for one in mixture.processes])
    means, stds = np.empty((len(mixture.processes), count)), np.empty((len(mixture.processes), count))
    for number, (one, (away, variances)) in enumerate(zip(mixture.processes, found, strict=True)):
        own = one.hyperparameters
        latent = own.prior_mean_ppb(one.places_m) + own.scale_ppb * (one.factor @ one.whitened - away)
        mean, variance = latent, own.scale_ppb**2 * variances
        if own.warp is not None:
            mean, variance = own.warp.moments(mean, variance)
        means[number], stds[number] = mean, np.sqrt(variance)
    expected, std = mixture_moments(mixture.weights, means, stds)
    scores = normal_scores(mixture.weights, found)
    levels = (NORMAL_ENDS[2], NORMAL_ENDS[3])
    if process.hyperparameters.alternatives:
        two, one_std = interval_levels(scores, NORMAL_ENDS[:1:-1])
        levels = (float(one_std), float(two))
    return CrossValidation(_measured(mixture.processes[0]), expected, std, scores, levels)


def _measured(process: GaussianProcess) -> FloatArray:
    """The values (n,) [ppb] that the process was conditioned on."""
    own = process.hyperparameters
    latent: FloatArray = own.prior_mean_ppb(process.places_m) + own.scale_ppb * (process.factor @ process.whitened)
    return latent if own.warp is None else own.warp.field(latent)
