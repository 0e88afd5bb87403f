"""Where a carried object may stand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.optimization.support.heights import occupancy, plan_view, underside
from tasks.optimization.support.supports import (
    allowed_shifts,
    support_map,
)
from tests.tasks.optimization.support.furnishings import (
    BELOW,
    CHAIR,
    CONFIG,
    SHELF,
    at,
    block,
    small,
    solid,
    upside_down,
)


@pytest.mark.parametrize("cell", [0.01, 0.02, 0.05])
def test_a_carried_object_may_go_where_its_carrier_is_and_nowhere_else(cell: float) -> None:
    reach = round(0.8 / cell)
    for shifts in (support_map, allowed_shifts) if cell == 0.05 else (support_map,):
        mug = at(0, block(0.1, 0.1, 0.1), 0, 0, 0.75)
        allowed = shifts(mug, BELOW, 0.0, cell, reach, CONFIG)
        assert allowed.shape == (2 * reach + 1, 2 * reach + 1)
        x, y = np.meshgrid(*[np.arange(-reach, reach + 1) * cell] * 2, indexing="ij")
        sure = (np.abs(np.abs(x) - 0.6) > 0.06) & (np.abs(np.abs(y) - 0.4) > 0.06)
        assert np.array_equal(allowed[sure], ((np.abs(x) < 0.6) & (np.abs(y) < 0.4))[sure])
        book, shelf = at(0, block(0.1, 0.1, 0.2), 0, 0.1, 1.02), at(1, SHELF, 0, 0, 0)
        inside = shifts(book, shelf, 0.0, cell, reach, CONFIG)
        steps = np.round(np.array([-0.4, 0.2, 0.3, 0.25]) / cell).astype(int) + reach
        assert inside[reach, steps[0] : steps[1] + 1].all()  # along the board, up to its sides
        assert not inside[reach, steps[2]]  # not into the side
        assert not inside[steps[3]].any()  # not off the board


@pytest.mark.whole
@given(seed=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_the_map_says_what_counting_cells_says(seed: int) -> None:
    """Boards with a hole and a rim, objects of many shapes: the compiled map against one shift at a time."""
    rng = np.random.default_rng(seed)
    board = solid(((0.5, 1.0, 0.03), (-0.3, 0, 0.7)), ((0.3, 1.0, 0.03), (0.35, 0, 0.7)), ((0.02, 1.0, 0.3), (0.49, 0, 0.7)))
    carrier = at(1, board, 0, 0, 0)
    obj = at(0, block(*rng.uniform(0.04, 0.12, 2), 0.2), rng.uniform(-0.45, -0.15), rng.uniform(-0.4, 0.4), 0.75, yaw=rng.uniform(0, 3))
    cell, reach = 0.02, 25
    found = support_map(obj, carrier, 0.02, cell, reach, CONFIG)
    cells, heights = underside(obj.surface, cell)
    assert len(cells) <= 200  # few enough that the map looks at all of them
    base = cells[heights <= obj.low[2] + CONFIG.base_m]
    low, high = obj.low[:2] - 1.0, obj.high[:2] + 1.0
    floor = plan_view(carrier.surface, low, high, 0.73 + CONFIG.base_m, cell, carrier.closed)
    blocks = occupancy(carrier.surface, low, high, 0.73 + CONFIG.base_m, 0.73 + 0.2 - CONFIG.cell_m, cell)

    def shares(shift: np.ndarray) -> tuple[float, float]:
        return float((np.abs(floor.at(base + shift) - 0.73) <= CONFIG.base_m).mean()), float(np.isfinite(blocks.at(cells + shift)).mean())

    here = shares(np.zeros(2, dtype=np.int64))
    for i, j in np.ndindex(found.shape):
        carried, blocked = shares(np.array([i - reach, j - reach]))
        expected = carried >= min(CONFIG.carried_share, here[0]) - 1e-9 and blocked <= here[1] + 0.02 + 1e-9
        assert found[i, j] == expected


def test_what_stands_on_its_second_level_stays_on_its_carrier() -> None:
    """A chair upside down, its back past the table's edge, may slide along the edge but not off the table."""
    chair = small(-0.46, 0, 0.3, upside_down(CHAIR, 0.92), "chair")
    allowed = support_map(chair, BELOW, 0.0, 0.02, 30, CONFIG)
    assert allowed[30, 30 - 8 : 30 + 9].all()
    assert not allowed[:10].any()  # 40 cm off the edge
    assert not allowed[:, 59:].any()
