"""Rugs end at walls, stay where they are, and are not carried about because of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st

from schemas.candidates import Asset
from schemas.capture import Instance, Shell
from tasks.geometry.transforms import yaw_pose
from tasks.optimization.coverings import CUT_NOTE, FREE_M, LEAST_LEFT, cut_at_walls
from tasks.optimization.proposals import Proposal
from tests.samples import sample
from tests.tasks.optimization.scenes import Scene, block, bounds, poses_of, remains

ROOM = sample(
    Shell, floor_polygon=((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)), walls=(), height_m=2.5,
    interior_walls=((0.5, 0.0, 2.0, 0.0, 0.1, 2.5),),
)  # fmt: skip
FREE = shapely.box(-2, -2, 2, 2).difference(shapely.box(0.5, -0.05, 2.0, 0.05))


def plan_of(proposal: Proposal, extents: tuple[float, float]) -> shapely.Polygon:
    half = 0.5 * np.array(extents) * proposal.scale[:2]
    corners = np.array([[-half[0], -half[1]], [half[0], -half[1]], half, [-half[0], half[1]]])
    return shapely.Polygon(corners @ proposal.pose[:2, :2].T + proposal.pose[:2, 3])


def rug_at(x: float, y: float, yaw: float, category: str = "rug", origin: str = "selection") -> Proposal:
    return Proposal(sample(Instance, instance_id="0000", category=category), "a" * 64, yaw_pose(yaw, [x, y, 0.0]), np.ones(3), origin)


@given(x=st.floats(-1.8, 1.8), y=st.floats(-1.8, 1.8), yaw=st.sampled_from([0.0, 0.5 * np.pi, 0.3, 2.0]), width=st.floats(0.6, 2.4))
def test_a_rug_that_was_cut_lies_on_the_floor_and_in_its_old_place(x: float, y: float, yaw: float, width: float) -> None:
    extents = (width, 1.2)
    assets = {"a" * 64: sample(Asset, asset_id="a" * 64, extents=(*extents, 0.01))}
    before = rug_at(x, y, yaw)
    (after,), notes = cut_at_walls([before], assets, ROOM)
    old, new = plan_of(before, extents), plan_of(after, extents)
    if after is before:
        assert notes == {}
        return
    assert notes == {"0000": CUT_NOTE}
    assert new.difference(FREE).area < 1e-3
    assert new.difference(old.buffer(1e-9)).area < 1e-9, "nothing is added"
    assert (after.scale[:2] >= LEAST_LEFT).all()
    assert after.scale[2] == 1.0


def test_only_what_reaches_into_walls_is_cut_and_only_so_far() -> None:
    assets = {"a" * 64: sample(Asset, asset_id="a" * 64, extents=(1.0, 1.2, 0.01))}
    inside = rug_at(-1.0, 0.0, 0.0)
    assert cut_at_walls([inside], assets, ROOM) == ([inside], {})
    (cut,), _ = cut_at_walls([rug_at(-1.6, 0.0, 0.0)], assets, ROOM)
    assert np.allclose(cut.scale, [0.9 - FREE_M, 1.0, 1.0])
    assert np.allclose(plan_of(cut, (1.0, 1.2)).bounds, [-2.0 + FREE_M, -0.6, -1.1, 0.6])
    for stays in (rug_at(-1.6, 0.0, 0.0, "table"), rug_at(-1.6, 0.0, 0.0, origin="annotation"), rug_at(-2.4, 0.0, 0.0)):
        assert cut_at_walls([stays], assets, ROOM) == ([stays], {})
    broken = dataclasses.replace(ROOM, floor_polygon=())
    assert cut_at_walls([rug_at(-1.6, 0.0, 0.0)], assets, broken)[1] == {}


def test_a_rug_below_a_wall_leaves_no_pair_in_each_other() -> None:
    scene = Scene()
    scene.shells = [dataclasses.replace(scene.shells[0], interior_walls=((0.5, 0.0, 2.0, 0.0, 0.1, 2.5),))]
    name = scene.add(block(1.4, 0.8, 0.02), yaw_pose(0.0, [1.2, -0.4, 0.0]), "rug")
    outcome = scene.run()
    (summary,) = outcome.rows["optimizations"]
    assert summary.deep_pairs == 0
    assert remains(outcome)[name] is None
    assert bounds(outcome, scene)[name][1, 1] <= -0.05 + 1e-9
    moved = poses_of(outcome)[name][:2, 3] - poses_of(outcome, "proposed")[name][:2, 3]
    assert np.hypot(*moved) < 1e-9


def test_a_rug_through_an_open_doorway_stays_whole() -> None:
    wall = ((-2.0, 0.0, 2.0, 0.0, 0.1, 2.5),)
    assets = {"a" * 64: sample(Asset, asset_id="a" * 64, extents=(0.8, 2.4, 0.01))}
    rug = rug_at(0.0, 0.2, 0.0)
    walled = dataclasses.replace(ROOM, interior_walls=wall, openings=())
    assert cut_at_walls([rug], assets, walled)[1] == {"0000": CUT_NOTE}
    parted = dataclasses.replace(ROOM, interior_walls=((-2.0, 0.0, -0.5, 0.0, 0.1, 2.5), (0.5, 0.0, 2.0, 0.0, 0.1, 2.5)), openings=())
    assert cut_at_walls([rug], assets, parted) == ([rug], {})
    opened = dataclasses.replace(ROOM, interior_walls=wall, openings=((-0.5, 0.0, 0.5, 0.0, 0.0, 2.0, 0.05),))
    assert cut_at_walls([rug], assets, opened) == ([rug], {})
