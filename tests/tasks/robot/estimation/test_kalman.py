"""The filter's steps against filterpy's, and what must hold of every covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.robot.estimation.kalman import Estimate, Innovation, doubted, floored, gate, nees, passes, predicted, updated

seeds = st.integers(0, 2**32 - 1)


def covariance(rng: np.random.Generator, size: int, spread: float = 1.0) -> np.ndarray:
    root = spread * rng.normal(size=(size, size))
    return root @ root.T + 0.01 * spread**2 * np.eye(size)


@settings(max_examples=50)
@given(seed=seeds, size=st.integers(1, 6))
def test_predictions_and_updates_are_those_of_filterpy(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    other = ExtendedKalmanFilter(size, 1)
    estimate = Estimate(rng.normal(size=size), covariance(rng, size))
    other.x, other.P = estimate.mean.copy(), estimate.covariance.copy()
    for _ in range(10):
        other.F, other.Q = np.eye(size) + 0.2 * rng.normal(size=(size, size)), covariance(rng, size, 0.1)
        estimate = predicted(estimate, np.sin(other.F @ estimate.mean), other.F, other.Q)
        other.predict()
        other.x = np.sin(other.x)
        count = int(rng.integers(1, size + 1))
        measured, jacobian, noise = rng.normal(size=count), rng.normal(size=(count, size)), covariance(rng, count)
        innovation = Innovation(measured - np.tanh(jacobian @ estimate.mean), jacobian, noise)
        estimate = updated(estimate, innovation)
        other.update(measured, lambda _, jacobian=jacobian: jacobian, lambda x, jacobian=jacobian: np.tanh(jacobian @ x), noise)
        np.testing.assert_allclose(estimate.mean, other.x, atol=1e-9)
        np.testing.assert_allclose(estimate.covariance, other.P, atol=1e-9)


@given(seed=seeds, exponent=st.integers(-12, 4), known=st.integers(-14, 2))
def test_a_covariance_stays_symmetric_and_positive(seed: int, exponent: int, known: int) -> None:
    """However much more precise a measurement is than the state, or less."""
    rng = np.random.default_rng(seed)
    estimate = Estimate(rng.normal(size=5), covariance(rng, 5, 10.0**known))
    for _ in range(5):
        innovation = Innovation(rng.normal(size=2), rng.normal(size=(2, 5)), covariance(rng, 2, 10.0**exponent))
        before, estimate = estimate, updated(estimate, innovation)
        np.testing.assert_array_equal(estimate.covariance, estimate.covariance.T)
        scale = np.abs(before.covariance).max()
        assert np.linalg.eigvalsh(estimate.covariance).min() >= -1e-12 * scale
        # What is measured is known no worse than before.
        assert np.linalg.eigvalsh(before.covariance - estimate.covariance).min() >= -1e-9 * scale


def test_the_gate_lets_its_share_of_true_measurements_pass() -> None:
    rng = np.random.default_rng(0)
    estimate = Estimate(np.zeros(3), covariance(rng, 3))
    for count in (1, 2, 3):
        jacobian, noise = rng.normal(size=(count, 3)), covariance(rng, count)
        spread = Innovation(np.zeros(count), jacobian, noise).covariance(estimate)
        drawn = rng.multivariate_normal(np.zeros(count), spread, size=4000)
        passed = np.mean([passes(estimate, Innovation(row, jacobian, noise), gate(0.95, count)) for row in drawn])
        assert abs(passed - 0.95) < 4 * math.sqrt(0.95 * 0.05 / 4000)
    assert gate(0.99, 1) == pytest.approx(2.5758293**2)
    assert gate(0.95, 2) == pytest.approx(-2 * math.log(0.05))
    assert gate(1.0, 3) == math.inf


@given(seed=seeds, size=st.integers(1, 3), far=st.floats(1.0, 1e4))
def test_an_estimate_that_doubts_itself_lets_the_measurement_in(seed: int, size: int, far: float) -> None:
    rng = np.random.default_rng(seed)
    estimate = Estimate(rng.normal(size=5), covariance(rng, 5, 1e-3))
    jacobian = np.linalg.qr(rng.normal(size=(5, size)))[0].T
    innovation = Innovation(far * rng.normal(size=size), jacobian, covariance(rng, size, 1e-3))
    freed = doubted(estimate, innovation)
    assert innovation.distance(freed) <= 1.0 + 1e-6
    assert np.linalg.eigvalsh(freed.covariance - estimate.covariance).min() >= -1e-9 * np.abs(freed.covariance).max()
    moved = updated(freed, innovation).mean - estimate.mean
    if np.linalg.norm(innovation.difference) > 1.0:
        np.testing.assert_allclose(jacobian @ moved, innovation.difference, rtol=0.01, atol=0.01 * np.linalg.norm(innovation.difference))


def test_the_error_is_measured_by_the_covariance_of_the_states_it_is_of() -> None:
    estimate = Estimate(np.zeros(4), np.diag([4.0, 9.0, 1.0, 1e-6]))
    assert nees(estimate, np.array([2.0, 3.0, 0.5])) == pytest.approx(1.0 + 1.0 + 0.25)
    rng = np.random.default_rng(1)
    spread = covariance(rng, 3)
    drawn = rng.multivariate_normal(np.zeros(3), spread, size=4000)
    assert np.mean([nees(Estimate(np.zeros(3), spread), row) for row in drawn]) == pytest.approx(3.0, abs=4 * math.sqrt(6 / 4000))


def test_no_measurement_is_perfect() -> None:
    raised = floored(np.zeros((2, 2)))
    assert (np.diag(raised) > 0).all()
    estimate = Estimate(np.zeros(2), np.zeros((2, 2)))
    assert np.isfinite(updated(estimate, Innovation(np.ones(2), np.eye(2), np.zeros((2, 2)))).mean).all()
