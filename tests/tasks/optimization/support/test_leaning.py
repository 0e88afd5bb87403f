"""How flat and long things lean, from points of one side of them."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.optimization.support.leaning import lean_of_points


def half_pole(lean: float, side: float) -> np.ndarray:
    """Points of the half of a pole that is seen from one side, shape (n, 3) [m]; it leans towards x.

    Args:
        lean: angle between the pole and the vertical [rad].
        side: direction from which the pole is seen, as an angle about its axis [rad].
    """
    random = np.random.default_rng(0)
    angle = side + random.uniform(-0.5 * np.pi, 0.5 * np.pi, 2000)
    along = random.uniform(0.0, 1.2, 2000)
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    return np.column_stack([0.015 * np.cos(angle), 0.015 * np.sin(angle), along]) @ turn.T


@pytest.mark.parametrize("side", np.linspace(0.0, np.pi, 5).tolist())
def test_a_pole_leans_alike_from_whichever_side_it_was_seen(side: float) -> None:
    lean = lean_of_points(half_pole(0.2, side), np.ones(2000))
    assert lean is not None
    assert lean.radians == pytest.approx(0.2, abs=0.01)
    assert lean.up == pytest.approx([np.sin(0.2), 0.0, np.cos(0.2)], abs=0.01)


@pytest.mark.parametrize("side", np.linspace(0.0, np.pi, 5).tolist())
def test_a_rod_that_lies_does_not_lean(side: float) -> None:
    assert lean_of_points(half_pole(0.5 * np.pi, side), np.ones(2000)) is None


@pytest.mark.parametrize(("lean", "is_lying"), [(0.15, False), (0.6, True)])
def test_a_picture_leans_by_the_angle_of_its_plane(lean: float, is_lying: bool) -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (2000, 3)) * [0.02, 0.8, 0.6]
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    result = lean_of_points(points @ turn.T, np.ones(2000))
    assert (result is None) == is_lying
    assert result is None or result.radians == pytest.approx(lean, abs=0.01)
