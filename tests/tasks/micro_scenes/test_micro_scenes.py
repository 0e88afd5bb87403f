from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.samples import fingerprint, sample
from schemas.candidates import Asset
from schemas.capture import Instance, Room, Scene, Shell
from schemas.errors import InputError
from schemas.micro_scenes import MicroScene, MicroSceneObject
from schemas.optimization import Placement, Support
from schemas.record import check
from tasks.geometry.transforms import flat, matrix, rotation_of, translation, yaw_pose
from tasks.micro_scenes import STAGE, MicroScenesConfig
from tasks.stage import Context, Outcome
from tests.tasks.micro_scenes.stacks import Stack, stacks

SCENE = "demo/room"
DESK, MUG, BOX = "0001", "0002", "0003"


@dataclasses.dataclass(frozen=True)
class Thing:
    """An object: its word, extents of its asset [m], and pose."""

    word: str
    extents: tuple[float, float, float]
    pose: np.ndarray
    room_index: int | None = 0


def at(x: float, y: float, z: float, yaw: float = 0.0) -> np.ndarray:
    return yaw_pose(yaw, [x, y, z])


def support(name: str, relation: str, parent: str | None = None, **values: Any) -> Support:
    given: dict[str, Any] = {"against": None, "is_kept": True, "gap_m": 0.0, "is_fixed": False}
    return sample(Support, scene_id=SCENE, instance_id=name, relation=relation, parent_id=parent, **(given | values))


def found(
    things: dict[str, Thing], supports: Sequence[Support] = (), *, kinds: Sequence[str] = ("office",), whole: str = "unknown",
    move: np.ndarray | None = None, config: MicroScenesConfig | None = None,
) -> Outcome:  # fmt: skip
    """Micro-scenes of things, moved together; rows in the order of the things."""
    moved = {name: (move if move is not None else np.eye(4)) @ thing.pose for name, thing in things.items()}
    outcome = STAGE.run(
        scenes=[sample(Scene, scene_id=SCENE, room_id="demo/place")],
        shells=[sample(Shell, scene_id=SCENE, room_type=whole)],
        rooms=[sample(Room, scene_id=SCENE, room_index=index, room_type=kind) for index, kind in enumerate(kinds)],
        instances=[
            sample(Instance, scene_id=SCENE, instance_id=name, category=thing.word, room_index=thing.room_index, is_structure=False)
            for name, thing in things.items()
        ],
        supports=list(supports),
        placements=[
            sample(
                Placement, scene_id=SCENE, instance_id=name, asset_id=fingerprint(name), scale=(1.0, 1.0, 1.0), optimized_pose=flat(pose)
            )
            for name, pose in moved.items()
        ],
        assets=[sample(Asset, asset_id=fingerprint(name), extents=thing.extents) for name, thing in things.items()],
        context=Context(SCENE, STAGE.name, 0, {}),
        config=config or MicroScenesConfig(),
    )
    check(outcome.rows["micro_scenes"], MicroScene)
    check(outcome.rows["micro_scene_objects"], MicroSceneObject)
    return outcome


def desk_with(**more: Thing) -> dict[str, Thing]:
    things = {DESK: Thing("office desk", (0.6, 1.4, 0.75), at(0, 0, 0)), MUG: Thing("coffee mug", (0.1, 0.1, 0.1), at(0.1, 0.2, 0.75))}
    return things | {f"{int(name[1:]):04d}": thing for name, thing in more.items()}


def belonging(outcome: Outcome) -> dict[str, tuple[str, str, str, int]]:
    return {r.instance_id: (r.large_id, r.parent_id, r.relation, r.depth) for r in outcome.rows["micro_scene_objects"]}


def numbers(outcome: Outcome) -> list[list[float]]:
    """All numbers of an outcome that must not depend on where the scene stands."""
    larges = [[*row.box_size] for row in outcome.rows["micro_scenes"]]
    smalls = [
        [*row.box_center, *row.box_size, np.cos(row.yaw_radians), np.sin(row.yaw_radians), row.tilt_radians]
        for row in outcome.rows["micro_scene_objects"]
    ]
    return larges + smalls


@given(
    stacks(), st.floats(-3.1, 3.1), st.tuples(st.floats(-20, 20), st.floats(-20, 20)), st.booleans(), st.randoms(use_true_random=False),
)  # fmt: skip
def test_rows_are_those_of_the_known_stacks_wherever_the_scene_stands(stack: Stack, turn: float, offset, is_told: bool, order) -> None:
    """From supports as from boxes alone, in any order of the rows; and frames lead back to where things stand in the world."""
    things = {
        name: Thing("table" if name not in stack.carried else "box", stack.extents[name], stack.poses[name]) for name in stack.extents
    }
    told = [support(name, one.relation, one.parent) for name, one in stack.carried.items()]
    plain, move = found(things), yaw_pose(turn, [*offset, 0.0])
    mixed = list(things.items())
    order.shuffle(mixed)
    moved = found(dict(mixed), told if is_told else (), move=move)
    assert belonging(plain) == belonging(moved)
    assert belonging(plain) == {
        name: (stack.roots[name], one.parent, one.relation, stack.depth(name)) for name, one in stack.carried.items()
    }
    carrying = sorted({stack.roots[name] for name in stack.carried})
    assert [row.instance_id for row in moved.rows["micro_scenes"]] == carrying
    counted = {row.instance_id: row.object_count for row in moved.rows["micro_scenes"]}
    assert counted == {name: sum(root == name for child, root in stack.roots.items() if child != name) for name in carrying}
    for mine, theirs in zip(numbers(plain), numbers(moved), strict=True):
        assert np.allclose(mine, theirs, atol=1e-6)
    frames = {row.instance_id: matrix(row.frame_pose) for row in moved.rows["micro_scenes"]}
    for row in moved.rows["micro_scene_objects"]:
        pose = move @ stack.poses[row.instance_id]
        middle = pose[:3, 3] + [0.0, 0.0, 0.5 * stack.extents[row.instance_id][2]]
        assert np.allclose((frames[row.large_id] @ [*row.box_center, 1.0])[:3], middle, atol=1e-6)
        turned = frames[row.large_id] @ yaw_pose(row.yaw_radians)
        assert np.allclose(turned[:3, :3], pose[:3, :3], atol=1e-6)


def test_a_desk_with_a_mug() -> None:
    outcome = found(desk_with())
    (large,), (small,) = outcome.rows["micro_scenes"], outcome.rows["micro_scene_objects"]
    assert (large.category, large.word, large.room_type, large.room_id, large.object_count) == (
        "desk",
        "office desk",
        "office",
        "demo/place",
        1,
    )
    assert (small.category, small.word, small.relation, small.depth, small.tilt_radians) == ("mug", "coffee mug", "on", 1, 0.0)
    assert small.box_center == pytest.approx((0.1, 0.2, 0.8))
    assert large.asset_id == fingerprint(DESK)
    assert small.asset_id == fingerprint(MUG)


@pytest.mark.parametrize(
    ("more", "told", "expected"),
    [
        # what is never small begins a micro-scene of its own on whatever it stands
        ({"_3": Thing("nightstand", (0.3, 0.3, 0.4), at(0, -0.3, 0.75)), "_4": Thing("cup", (0.1, 0.1, 0.1), at(0, -0.3, 1.15))}, (),
         {MUG: (DESK, DESK, "on", 1), "0004": (BOX, BOX, "on", 1)}),
        # a word that nobody knows is an object, which can be small
        ({"_3": Thing("spaceship", (0.3, 0.3, 0.4), at(0, -0.3, 0.75))}, (), {MUG: (DESK, DESK, "on", 1), BOX: (DESK, DESK, "on", 1)}),
        # what is only small carries nothing of its own
        ({"_3": Thing("pillow", (0.6, 0.6, 0.2), at(3, 0, 0)), "_4": Thing("cup", (0.1, 0.1, 0.1), at(3, 0, 0.2))}, (),
         {MUG: (DESK, DESK, "on", 1)}),
        # a rug is a part of the floor, also where a scene says that it carries
        ({"_3": Thing("rug", (3, 3, 0.015), at(0, 0, 0)), "_4": Thing("box", (0.1, 0.1, 0.1), at(1, 1, 0.015))},
         (support(DESK, "on", BOX), support("0004", "on", BOX), support(BOX, "floor")), {MUG: (DESK, DESK, "on", 1)}),
        # a tablecloth is not: it lies on furniture
        ({"_3": Thing("tablecloth", (0.5, 1.0, 0.01), at(0, 0, 0.75))}, (support(MUG, "on", BOX), support(BOX, "on", DESK)),
         {MUG: (DESK, BOX, "on", 2), BOX: (DESK, DESK, "on", 1)}),
        # what hangs over the desk is not on it, whatever its box touches
        ({"_3": Thing("picture", (0.05, 0.4, 0.4), at(-0.2, -0.3, 0.76))}, (support(BOX, "wall", against="wall_00"),),
         {MUG: (DESK, DESK, "on", 1)}),
        ({"_3": Thing("curtain", (0.05, 0.4, 0.4), at(-0.2, -0.3, 0.76))}, (), {MUG: (DESK, DESK, "on", 1)}),
        # a support that no longer holds says nothing, and boxes do
        ({"_3": Thing("box", (0.3, 0.3, 0.3), at(2, 0, 0))}, (support(MUG, "on", BOX, is_kept=False),), {MUG: (DESK, DESK, "on", 1)}),
        # a support says more than boxes
        ({"_3": Thing("box", (0.3, 0.3, 0.3), at(2, 0, 0))}, (support(MUG, "inside", BOX),), {MUG: (BOX, BOX, "inside", 1)}),
        ({}, (support(MUG, "none"),), {}),
    ],
)  # fmt: skip
def test_what_belongs_to_what(more: dict[str, Thing], told: Sequence[Support], expected: dict[str, tuple[str, str, str, int]]) -> None:
    assert belonging(found(desk_with(**more), told)) == expected


def test_a_picture_leans_on_the_desk_that_it_stands_beside_and_carries() -> None:
    pose = translation([0.44, 0.0, 0.0])
    pose[:3, :3] = rotation_of([0.0, -0.2, 0.0])
    board = Thing("picture", (0.02, 0.5, 0.6), pose)
    outcome = found(desk_with(_3=board), [support(DESK, "floor"), support(BOX, "floor")])
    assert belonging(outcome) == {BOX: (DESK, DESK, "leans", 1), MUG: (DESK, DESK, "on", 1)}
    (leaning,) = [row for row in outcome.rows["micro_scene_objects"] if row.instance_id == BOX]
    assert leaning.tilt_radians == pytest.approx(0.2)
    assert belonging(found(desk_with(_3=board), [support(BOX, "wall", against="wall_00")])) == {MUG: (DESK, DESK, "on", 1)}
    upright = dataclasses.replace(board, pose=at(0.33, 0, 0))
    assert belonging(found(desk_with(_3=upright))) == {MUG: (DESK, DESK, "on", 1)}


@pytest.mark.parametrize(
    ("kinds", "whole", "index", "expected"),
    [
        (("kitchen", "bedroom"), "dwelling", 1, "bedroom"), (("kitchen", "bedroom"), "dwelling", None, "unknown"),
        (("unknown", "bedroom"), "dwelling", 0, "unknown"), (("unknown",), "office", 0, "office"),
        (("kitchen",), "kitchen", None, "kitchen"),
        ((), "bathroom", None, "bathroom"),
    ],
)  # fmt: skip
def test_the_kind_of_room_is_that_of_the_room_else_of_the_whole(kinds: Sequence[str], whole: str, index: int | None, expected: str) -> None:
    things = {name: dataclasses.replace(thing, room_index=index) for name, thing in desk_with().items()}
    (row,) = found(things, kinds=kinds, whole=whole).rows["micro_scenes"]
    assert (row.room_type, row.room_index) == (expected, index)


def test_a_scene_without_anything_has_no_micro_scenes() -> None:
    assert found({}).rows == {"micro_scenes": [], "micro_scene_objects": []}


def test_what_cannot_be_is_refused() -> None:
    circle = [support(DESK, "on", MUG), support(MUG, "on", DESK)]
    things = {DESK: Thing("box", (1, 1, 1), at(0, 0, 0)), MUG: Thing("box", (1, 1, 1), at(5, 0, 0))}
    with pytest.raises(InputError, match="carry each other in a circle"):
        found(things, circle)
    empty: dict[str, Any] = {table: [] for table in STAGE.reads}
    context, config = Context(SCENE, STAGE.name, 0, {}), MicroScenesConfig()
    with pytest.raises(InputError, match="scenes: has no row"):
        STAGE.run(**empty, context=context, config=config)
    one = empty | {"scenes": [sample(Scene, scene_id=SCENE)], "shells": [sample(Shell, scene_id=SCENE)]}
    one["placements"] = [sample(Placement, scene_id=SCENE, instance_id=DESK)]
    with pytest.raises(InputError, match="placement 0001: its instance is not in instances"):
        STAGE.run(**one, context=context, config=config)
    one["instances"] = [sample(Instance, scene_id=SCENE, instance_id=DESK)]
    with pytest.raises(InputError, match="is not in assets"):
        STAGE.run(**one, context=context, config=config)


def test_a_table_of_ones_own_decides_by_its_content(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        "object: {large: false, small: true, source: inferred, words: []}\n"
        "furniture: {large: true, small: false, source: inferred, words: [office desk]}\n"
    )
    config = MicroScenesConfig(categories=str(file))
    assert config.categories_sha256 != MicroScenesConfig().categories_sha256
    outcome = found(desk_with(), config=config)
    assert [row.category for row in (*outcome.rows["micro_scenes"], *outcome.rows["micro_scene_objects"])] == ["furniture", "object"]
    file.write_text(file.read_text().replace("office desk", "desk"))
    with pytest.raises(InputError, match="has changed since the run was planned"):
        found(desk_with(), config=config)
    assert MicroScenesConfig(categories=str(file)) != config
