"""What the estimation's models are held against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm


def slope(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Jacobian of a function by central differences of fourth order."""
    columns = []
    for index in range(len(at)):
        move = np.zeros(len(at))
        move[index] = step
        near, far = function(at + move) - function(at - move), function(at + 2 * move) - function(at - 2 * move)
        columns.append((8 * near - far) / (12 * step))
    return np.array(columns).T


def acceleration_noise(most: float, lasts: float, seconds: float) -> np.ndarray:
    """Covariance of way, speed and acceleration by an acceleration that wanders (Singer 1970; van Loan 1978), shape (3, 3)."""
    motion = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / lasts]])
    density = np.diag([0.0, 0.0, 2.0 / lasts * most**2 / 3.0])
    both = np.block([[-motion, density], [np.zeros((3, 3)), motion.T]]) * seconds
    exponential = expm(both)
    return exponential[3:, 3:].T @ exponential[:3, 3:]
