"""Annotations that hold more than what they name: what the kind of the object tells is left out of its box."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.instances.merged import own_part
from tests.tasks.capture.test_hidden import grid


@given(height=st.floats(-0.05, 0.3), noise=st.sampled_from([0.0, 0.004]), side=st.floats(0.2, 0.6), seed=st.integers(0, 3))
def test_a_rug_is_flat_whatever_was_annotated_with_it(height: float, noise: float, side: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rug = grid((0.0, 0.0, height), (2.0, 1.4, height + 0.01))
    rug = rug + rng.normal(0.0, noise, rug.shape)
    sofa = grid((0.2, 0.2, height + 0.1), (0.2 + side, 0.2 + side, height + 0.5), 0.05)
    own = own_part(np.concatenate([rug, sofa]), "rug")
    assert own[: len(rug)].all()
    assert not own[len(rug) :].any()


@pytest.mark.parametrize("category", ["table", "coffee table", "kitchen counter", "desk"])
def test_what_stands_on_a_table_is_none_of_it(category: str) -> None:
    table = grid((0.0, 0.0, 0.7), (1.4, 0.8, 0.74))
    legs = grid((0.0, 0.0, 0.0), (0.04, 0.04, 0.7))
    machine = grid((0.3, 0.3, 0.75), (0.6, 0.55, 1.05))
    own = own_part(np.concatenate([table, legs, machine]), category)
    assert own[: len(table) + len(legs)].all()
    assert not own[len(table) + len(legs) :][machine[:, 2] > 0.77].any()


def test_what_belongs_above_a_top_stays() -> None:
    """A desk with a shelf over half of it, a sofa with its back, a chair: all of them is theirs."""
    desk = np.concatenate([grid((0.0, 0.0, 0.7), (1.4, 0.8, 0.74)), grid((0.0, 0.4, 1.1), (1.4, 0.8, 1.2))])
    assert own_part(desk, "desk").all()
    seat_and_back = np.concatenate([grid((0.0, 0.0, 0.4), (0.5, 0.5, 0.45)), grid((0.0, 0.45, 0.45), (0.5, 0.5, 0.9))])
    for category in ("sofa", "chair", "thing"):
        assert own_part(seat_and_back, category).all()


def test_a_rolled_carpet_is_no_flat_one() -> None:
    roll = grid((0.0, 0.0, 0.0), (0.2, 0.2, 1.6))
    assert own_part(roll, "carpet").all()
