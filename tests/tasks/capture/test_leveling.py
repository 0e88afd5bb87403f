"""The floor of a scan that names one: the lowest of several storeys, whatever else is called a floor."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.capture.labels import label_map
from tasks.capture.leveling import aligned
from tasks.capture.reading import Reading, groups_of
from tasks.capture.segmentation.votes import VoteConfig
from tests.capture_scans import Mesh, plate
from tests.tasks.capture.storeys.houses import Builder, House


def floor_at(house: House) -> float:
    """Height that is taken for the floor of a house whose instances are named [m]."""
    reading = Reading(house.surface, groups=groups_of(
        [(str(n), label, np.flatnonzero(house.instance == n)) for n, label in enumerate(house.labels)], house.instance, house.surface
    ))  # fmt: skip
    meanings = [label_map()[group.raw_label] for group in reading.groups or ()]
    return -float(aligned(reading, house.surface, meanings, VoteConfig(), is_authored=False).pose[2, 3])


def stray(size: float, height: float, step: float) -> Mesh:
    """A square below or above a corner of the room."""
    return plate([0.5, 0.5, height], [size, 0, 0], [0, size, 0], step)


@settings(max_examples=25, deadline=None)
@given(
    height=st.one_of(st.floats(-4.0, -2.0), st.floats(2.0, 4.0)), size=st.floats(0.5, 1.6), step=st.sampled_from([0.03, 0.1, 0.5]),
    drawn=st.sampled_from([0.1, 0.5, 3.0]),
)  # fmt: skip
def test_what_is_called_a_floor_by_mistake_does_not_move_it(height: float, size: float, step: float, drawn: float) -> None:
    """Up to a tenth of the area, in any number of faces: reflections in a polished floor, a table that was mislabelled."""
    builder = Builder(step=drawn)
    builder.room(0, (0, 0, 0), (5.0, 5.5, 2.5))
    builder.add("floor", 0, stray(size, height, step))
    assert floor_at(builder.house((0.0,))) == pytest.approx(0.0, abs=0.01)


@settings(max_examples=15, deadline=None)
@given(share=st.floats(0.3, 1.0), rise=st.floats(2.4, 3.5), fine=st.booleans())
def test_of_several_storeys_it_is_the_lowest_with_a_real_share(share: float, rise: float, fine: bool) -> None:
    """A cellar of a third of the house, also where the floor above it was meshed more finely."""
    builder = Builder(step=0.5)
    builder.room(0, (0, 0, 0), (6.0, 7.0 * share, rise - 0.3))
    builder.step = 0.1 if fine else 0.5
    builder.room(1, (0, 0, rise), (6.0, 7.0, 2.5))
    assert floor_at(builder.house((0.0, rise))) == pytest.approx(0.0, abs=0.01)
