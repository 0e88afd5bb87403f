"""Slanted walls below a roof: where they begin, how far they reach, and that the replica's shell is what was scanned."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tasks.fidelity.replicas import replica_surface
from tasks.geometry.proximity import closest_points
from tasks.optimization.solids import shell_solids
from tasks.shell import ShellConfig, room_shell, wall_of
from tests.capture_scans import plate
from tests.tasks.capture.test_partitions import DEPTH, HEIGHT, WIDTH, Piece, estimated, shell, solid_piece


def attic(knee: float, reach: float, low: float = 0.0, high: float = WIDTH) -> list[Piece]:
    """A room with a slope over a part of its first wall, which is seen below it only."""
    rest = [piece for i, piece in enumerate(shell()) if i != 1]
    below = [("wall", plate([low, 0, 0], [0, 0, knee], [high - low, 0, 0]))]
    beside = [("wall", plate([a, 0, 0], [0, 0, HEIGHT], [b - a, 0, 0])) for a, b in ((0.0, low), (high, WIDTH)) if b - a > 0.1]
    ceiling = ("ceiling", plate([0, reach, HEIGHT], [0, DEPTH - reach, 0], [WIDTH, 0, 0]))
    slope = ("wall", plate([low, 0, knee], [0, reach, HEIGHT - knee], [high - low, 0, 0]))
    return [*rest, *below, *beside, slope, ceiling]


@pytest.mark.whole
@given(st.floats(0.6, 1.6), st.floats(0.7, 2.0), st.floats(0.0, 2.5), st.floats(1.5, 3.5), st.booleans())
@settings(max_examples=25, deadline=None)
def test_a_slope_begins_and_ends_where_it_was_scanned(knee: float, reach: float, low: float, length: float, is_noisy: bool) -> None:
    assume(HEIGHT - knee < reach * np.tan(np.deg2rad(60.0)))  # what is steeper is a wall in part
    low = 0.0 if low < 0.35 else low
    high = WIDTH if low + length > WIDTH - 0.35 else low + length
    shape = estimated(attic(knee, reach, low, high), noise=0.003 if is_noisy else 0.0)
    (row,) = [slope.row for slope in shape.slopes]
    ends = np.array(row[:4]).reshape(2, 2)
    assert np.abs(ends[:, 1]).max() < 0.03, "on the wall's inner face"
    assert np.abs(np.sort(ends[:, 0]) - [low, high]).max() < 0.08
    assert row[4] == pytest.approx(knee, abs=0.08)
    assert row[5] == pytest.approx(reach, abs=0.1)


def test_the_shell_lies_where_the_slope_was_seen_and_its_underside_is_what_is_seen() -> None:
    shape = estimated(attic(1.2, 1.3, 1.0, 4.0))
    row = shape.row("scans/one", [])
    parts = room_shell(row, ShellConfig(ceiling=True))
    slope = np.array([[x, 1.3 * t, 1.2 + (HEIGHT - 1.2) * t] for x in np.linspace(1.1, 3.9, 9) for t in np.linspace(0.05, 0.95, 9)])
    away = np.min([closest_points(part.vertices, part.faces, slope).distance for _, part in parts], axis=0)
    assert away.max() < 0.05
    assert all(part.is_watertight and part.is_convex and part.volume > 0.0 for name, part in parts if name != "floor")
    seen = replica_surface(row, [], [], {}).shell
    triangles = seen.vertices[seen.faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 2
    leaning = (normals[:, 2] < -0.2 * 2 * areas) & (normals[:, 1] > 0.0)
    assert areas[leaning].sum() == pytest.approx(3.0 * np.hypot(1.3, HEIGHT - 1.2), rel=0.08)


def test_its_wedge_is_a_part_of_its_wall_and_in_the_way_of_what_is_tall() -> None:
    row = estimated(attic(1.2, 1.3)).row("scans/one", [])
    names = [name for name, _ in room_shell(row)]
    assert len(set(names)) == len(names)
    (wall,) = [solid for solid in shell_solids(row) if len(solid.hulls) > 1]
    assert wall.name in {wall_of(name) for name in names}
    wedge = max(wall.hulls, key=lambda hull: hull.vertices[:, 1].max()).vertices
    assert wedge[:, 2].min() == pytest.approx(1.2, abs=0.08)
    assert wedge[:, 1].max() == pytest.approx(1.3, abs=0.1)


@pytest.mark.parametrize(
    "pieces",
    [
        shell(),
        [*shell(), solid_piece("wardrobe", (1.0, 0.1, 0.0), (3.0, 0.7, 2.0))],
        [*shell(), ("wardrobe", plate([1.0, 0.0, 1.0], [0, 1.2, 1.2], [3.0, 0, 0]))],  # a thing that leans at the wall
        [*shell(), ("wall", plate([1.0, 0.0, 2.2], [0, 0.2, 0.3], [3.0, 0, 0]))],  # a molding
        [*shell(), ("ceiling", plate([0, 0, HEIGHT - 0.2], [0, DEPTH, 0.2], [WIDTH, 0, 0]))],  # a ceiling that is not quite level
    ],
    ids=["upright", "wardrobe", "leaning thing", "molding", "ceiling"],
)
def test_upright_walls_have_none(pieces: list[Piece]) -> None:
    assert estimated(pieces).slopes == ()
