"""An extended Kalman filter's two steps, and the gate before the second."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_VARIANCE = 1e-9
"""Of a measurement: no sensor is better, and no innovation covariance is singular."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """What is believed of a state: mean, shape (n,), and covariance, shape (n, n)."""

    mean: Array
    covariance: Array


@dataclasses.dataclass(frozen=True)
class Innovation:
    """What a measurement says beyond what was expected.

    difference: Measured less expected, angles wrapped, shape (m,). jacobian: Of what is measured by the state, shape (m, n). noise: Of the
    measurement, its covariance, shape (m, m).
    """

    difference: Array
    jacobian: Array
    noise: Array

    def covariance(self, estimate: Estimate) -> Array:
        """Of the difference, as the estimate has it, shape (m, m)."""
        spread: Array = self.jacobian @ estimate.covariance @ self.jacobian.T + floored(self.noise)
        return spread

    def distance(self, estimate: Estimate) -> float:
        """Squared Mahalanobis distance of the difference; chi-square with m degrees where estimate and noise are right."""
        return float(self.difference @ np.linalg.solve(self.covariance(estimate), self.difference))


def predicted(estimate: Estimate, mean: Array, jacobian: Array, noise: Array) -> Estimate:
    """After a motion: its mean, the motion's jacobian by the state, shape (n, n), and what it adds to the covariance, shape (n, n)."""
    return Estimate(mean, _symmetric(jacobian @ estimate.covariance @ jacobian.T + noise))


def updated(estimate: Estimate, innovation: Innovation) -> Estimate:
    """After a measurement. The covariance is Joseph's form: symmetric and positive whatever the gain's rounding."""
    jacobian = innovation.jacobian
    gain = np.linalg.solve(innovation.covariance(estimate), jacobian @ estimate.covariance).T
    kept = np.eye(len(estimate.mean)) - gain @ jacobian
    covariance = kept @ estimate.covariance @ kept.T + gain @ floored(innovation.noise) @ gain.T
    return Estimate(estimate.mean + gain @ innovation.difference, _symmetric(covariance))


def doubted(estimate: Estimate, innovation: Innovation) -> Estimate:
    """The estimate once it admits to be wrong by what a measurement says: its covariance grows by the square of the difference.

    For measurements that disagree with it again and again. To inflate their noise would keep an estimate that they contradict; this lets
    it follow them, and what it knows across the difference stays.
    """
    wrong = np.linalg.pinv(innovation.jacobian) @ innovation.difference
    return Estimate(estimate.mean, estimate.covariance + np.outer(wrong, wrong))


def passes(estimate: Estimate, innovation: Innovation, threshold: float) -> bool:
    """Whether a measurement is near enough to what was expected to be taken for true: its squared distance is below a threshold."""
    return innovation.distance(estimate) <= threshold


def gate(share: float, count: int) -> float:
    """Squared distance that this share of true measurements of so many numbers keeps to: the chi-square quantile; infinite for 1."""
    from scipy.stats import chi2

    return float(chi2.ppf(share, count)) if share < 1 else math.inf


def nees(estimate: Estimate, error: Array) -> float:
    """Normalized estimation error squared of the first states, whose error has shape (k,); k on average where the filter is consistent
    (Bar-Shalom, Li and Kirubarajan 2001)."""
    count = len(error)
    return float(error @ np.linalg.solve(estimate.covariance[:count, :count], error))


def floored(noise: Array) -> Array:
    """A covariance with no variance below `LEAST_VARIANCE`."""
    raised = noise.copy()
    np.fill_diagonal(raised, np.maximum(np.diag(noise), LEAST_VARIANCE))
    return raised


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)
