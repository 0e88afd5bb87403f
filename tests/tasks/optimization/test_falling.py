"""Letting fall: what fails its certificate lies where it comes to rest, near, apart from all else, and at nobody's cost."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from tasks.geometry.transforms import rotation_of, yaw_pose
from tasks.optimization import falling
from tasks.optimization.bodies import BodyConfig, bodies_of
from tasks.optimization.certificates import CertificateConfig, Certified, certify
from tasks.optimization.contacts import Colliders
from tasks.optimization.default import Default
from tasks.optimization.falling import Fall, let_fall
from tasks.optimization.interior import Interior
from tasks.optimization.search.trace import moved_poses
from tests.tasks.optimization.interiors import Object, block, interior_of

SLAB = ("table", [block((1.2, 1.2, 0.4))], yaw_pose(0.0))


def leaning(size: tuple[float, float, float], angle: float, at: tuple[float, float, float], category: str = "box") -> Object:
    """A block that is turned about its lower edge along y, which stays where it is [rad]."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_of([0.0, angle, 0.0])
    corner = pose[:3, :3] @ np.array([0.5 * size[0] * np.sign(angle), 0.0, 0.0])
    pose[:3, 3] = np.array(at) - corner
    return category, [block(size)], pose


def fallen(*objects: Object, method: Default | None = None) -> tuple[Interior, Fall, Fall]:
    """An interior, what its certificates say where the objects are, and what letting fall makes of that."""
    interior = interior_of(objects)
    bodies, _ = bodies_of(interior, [], BodyConfig())
    config = CertificateConfig()
    before = Fall(interior.poses, (), certify(bodies, interior.poses, interior.shell, config))
    after = let_fall(interior, interior.poses, before.certified, bodies, {}, method or Default(), config)
    return interior, before, after


def restless(certified: list[Certified]) -> set[str]:
    return {c.name for c in certified if not (c.is_stable_1cm and c.is_stable_5cm and c.is_stable_nudged)}


def overlap(interior: Interior, fall: Fall) -> float:
    """Deepest overlap [m]."""
    return max((p.depth_m for p in Colliders(interior.solids, interior.shell).penetrations(fall.poses)), default=0.0)


def test_what_leans_on_nothing_lies_where_it_comes_to_rest() -> None:
    interior, before, after = fallen(leaning((0.1, 0.3, 0.3), 0.6, (0.0, 0.0, 0.0)))
    assert restless(before.certified) == {"0000"}
    assert restless(after.certified) == set()
    (pose,) = after.poses
    vertices = interior.solids[0].placed(pose)[0].vertices
    assert np.ptp(vertices[:, 2]) == pytest.approx(0.1, abs=1e-4), "it lies on its broad side"
    assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-4)
    assert overlap(interior, after) <= Default().slop_m


def test_the_trace_of_a_fall_leads_to_where_it_lies_bit_for_bit() -> None:
    interior, _, after = fallen(SLAB, leaning((0.06, 0.2, 0.2), 0.5, (0.1, 0.2, 0.4)))
    assert [name for name, _ in after.moves] == ["0001"] * len(after.moves)
    assert after.moves
    parents = {name: c.parent_id for name, c in zip(interior.names, interior.carriers, strict=True)}
    replayed = moved_poses(dict(zip(interior.names, interior.poses, strict=True)), parents, after.moves)
    np.testing.assert_array_equal([replayed[name] for name in interior.names], after.poses)


def test_what_stands_stays_to_the_bit_and_is_not_asked_again() -> None:
    _, before, after = fallen(SLAB, ("box", [block((0.2, 0.2, 0.2))], yaw_pose(0.3, [0.1, 0.1, 0.4])))
    assert after.poses.tobytes() == before.poses.tobytes()
    assert after.certified is before.certified


def test_furniture_is_not_thrown_over() -> None:
    _, before, after = fallen(leaning((0.2, 0.5, 1.2), 0.6, (0.0, 0.0, 0.0), "bookshelf"))
    assert restless(before.certified) == {"0000"}
    assert after.moves == ()


def test_what_would_fall_off_its_carrier_or_far_keeps_its_place() -> None:
    over_the_edge = leaning((0.05, 0.2, 0.25), 0.5, (0.56, 0.0, 0.4))
    _, before, after = fallen(SLAB, over_the_edge)
    assert restless(before.certified) == {"0001"}
    assert after.moves == ()
    for height, falls in ((0.14, True), (0.16, False)):
        _, before, after = fallen(("box", [block((0.2, 0.2, 0.2))], yaw_pose(0.0, [0.0, 0.0, height])))
        assert restless(before.certified) == {"0000"}
        assert bool(after.moves) == falls
    _, _, bounded = fallen(leaning((0.1, 0.3, 0.3), 0.6, (0.0, 0.0, 0.0)), method=Default(most_way_m=0.0))
    assert bounded.moves == ()


def test_nothing_else_is_moved_for_a_fall() -> None:
    """A stick that would come to lie where a book stands keeps its place; moved aside by a hand's breadth, it falls, and the book stays."""
    for distance, falls in ((0.1, False), (0.4, True)):
        book = ("book", [block((0.03, 0.2, 0.2))], yaw_pose(0.0, [distance, 0.0, 0.4]))
        interior, before, after = fallen(SLAB, leaning((0.02, 0.1, 0.3), 0.5, (0.0, 0.0, 0.4)), book)
        assert "0001" in restless(before.certified)
        assert {name for name, _ in after.moves} == ({"0001"} if falls else set())
        place = interior.names.index("0002")
        assert after.poses[place].tobytes() == before.poses[place].tobytes()
        assert restless(after.certified) == (set() if falls else restless(before.certified))


def test_what_fell_meets_nothing_that_went_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two that fell, one beside the other, the first is restless and goes back into the second: then neither falls."""
    first, second = (leaning((0.03, 0.3, 0.3), 0.35, (x, 0.0, 0.4)) for x in (-0.3, 0.3))
    interior, before, after = fallen(SLAB, first, second)
    assert {name for name, _ in after.moves} == {"0001", "0002"}
    crossing = dict(after.moves)
    crossing["0002"] = (crossing["0002"][0] - 0.6, *crossing["0002"][1:])  # to where the first one stood
    rounds = iter([list(crossing.items())])
    monkeypatch.setattr(falling, "_falling", lambda *_: next(rounds, []))
    asked: list[list[Certified]] = []

    def certify_so(bodies: object, poses: np.ndarray, shell: object, config: object, spread: object, *_: object) -> list[Certified]:
        """After the fall only the first one moves."""
        made = [dataclasses.replace(row, is_stable_1cm=row.name != "0001", is_stable_5cm=row.name != "0001", is_stable_nudged=True)
                for row in before.certified]  # fmt: skip
        asked.append(made)
        return made

    monkeypatch.setattr(falling, "certify", certify_so)
    bodies, _ = bodies_of(interior, [], BodyConfig())
    made = let_fall(interior, before.poses, before.certified, bodies, {}, Default(), CertificateConfig())
    assert len(asked) == 1, "it is not asked for nothing"
    assert made.moves == ()
    assert made.poses.tobytes() == before.poses.tobytes()


def test_only_what_a_fall_concerns_is_simulated_while_it_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pile far off sleeps meanwhile; what is certified in the end is the whole scene where things lie, to the bit."""
    pile = [("box", [block((0.2, 0.2, 0.2))], yaw_pose(0.0, [2.0, 0.0, z])) for z in (0.0, 0.2)]
    neighbor = ("box", [block((0.1, 0.1, 0.1))], yaw_pose(0.0, [-0.5, -0.5, 0.4]))
    asked: list[tuple[list[Certified], set[int]]] = []

    def certify_so(*given: Any) -> list[Certified]:
        made = certify(*given)
        asked.append((made, set(given[5] if len(given) > 5 else ())))
        return made

    monkeypatch.setattr(falling, "certify", certify_so)
    interior, before, after = fallen(SLAB, leaning((0.1, 0.3, 0.3), 0.6, (0.0, 0.0, 0.4)), neighbor, *pile)
    assert [name for name, _ in after.moves] == ["0001"]
    assert {interior.names[i] for i in after.concerned} == {"0000", "0001", "0002"}
    *tried, (last, slept) = asked
    assert tried
    assert {interior.names[i] for _, asleep in tried for i in asleep} == {"0003", "0004"}
    assert slept == set()
    bodies, _ = bodies_of(interior, [], BodyConfig())
    whole = certify(bodies, after.poses, interior.shell, CertificateConfig())
    assert [repr(row) for row in after.certified] == [repr(row) for row in last] == [repr(row) for row in whole]
    assert restless(before.certified) == {"0001"}
    assert restless(whole) == set()
    for row, partly in zip(whole, tried[-1][0], strict=True):
        assert row.settled_pose is not None
        assert partly.settled_pose is not None
        np.testing.assert_allclose(row.settled_pose, partly.settled_pose, atol=1e-3)


def test_what_is_restless_in_the_whole_room_goes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """While falls were tried it stayed: the rest of the room slept. What fell beside it stays where it fell."""
    first, second = (leaning((0.03, 0.3, 0.3), 0.35, (x, 0.0, 0.4)) for x in (-0.3, 0.3))
    far = ("box", [block((0.2, 0.2, 0.2))], yaw_pose(0.0, [2.0, 0.0, 0.0]))
    interior, before, after = fallen(SLAB, first, second, far)
    assert {name for name, _ in after.moves} == {"0001", "0002"}
    rounds = iter([list(after.moves)])
    monkeypatch.setattr(falling, "_falling", lambda *_: next(rounds, []))
    wholes: list[list[Certified]] = []

    def certify_so(*given: Any) -> list[Certified]:
        """The first one moves where all is awake and the second has fallen, too."""
        made = certify(*given)
        if len(given) > 5:
            return made
        is_restless = not wholes
        made = [dataclasses.replace(row, is_stable_1cm=False) if row.name == "0001" and is_restless else row for row in made]
        wholes.append(made)
        return made

    monkeypatch.setattr(falling, "certify", certify_so)
    bodies, _ = bodies_of(interior, [], BodyConfig())
    made = let_fall(interior, before.poses, before.certified, bodies, {}, Default(), CertificateConfig())
    assert {name for name, _ in made.moves} == {"0002"}
    assert len(wholes) == 2
    assert made.certified is wholes[-1]


def test_what_is_fixed_is_certified_where_things_fell(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slab that is fixed has no certificate of something that is in it no more."""
    interior, before, after = fallen(SLAB, leaning((0.1, 0.3, 0.3), 0.6, (0.0, 0.0, 0.4)))
    bodies, _ = bodies_of(interior, [], BodyConfig())
    fixed = [dataclasses.replace(body, is_fixed=body.solid.name == "0000") for body in bodies]
    certified = certify(fixed, before.poses, interior.shell, CertificateConfig())
    made = let_fall(interior, before.poses, certified, fixed, {}, Default(), CertificateConfig())
    assert {name for name, _ in made.moves} == {"0001"} == {name for name, _ in after.moves}
    whole = certify(fixed, made.poses, interior.shell, CertificateConfig())
    assert [repr(row) for row in made.certified] == [repr(row) for row in whole]


def test_what_is_hit_is_certified_with_its_neighbors(monkeypatch: pytest.MonkeyPatch) -> None:
    interior, before, _ = fallen(
        SLAB, leaning((0.1, 0.3, 0.3), 0.6, (0.0, 0.0, 0.4)),
        *[("box", [block((0.2, 0.2, 0.2))], yaw_pose(0.0, [x, 0.0, 0.0])) for x in (2.0, 2.205, 4.0)],
    )  # fmt: skip
    asked: list[list[int]] = []

    def certify_so(*given: Any) -> list[Certified]:
        """Something that sleeps beside another is hit at first."""
        asleep = given[5]
        asked.append(asleep)
        return [
            dataclasses.replace(row, displacement_m=float(number % 5 == 2 or number % 5 not in asleep), nudged_displacement_m=0.0)
            for number, row in enumerate(before.certified)
        ]

    monkeypatch.setattr(falling, "certify", certify_so)
    bodies, _ = bodies_of(interior, [], BodyConfig())
    let_fall(interior, before.poses, before.certified, bodies, {}, Default(), CertificateConfig())
    assert [interior.names[i] for i in asked[0]] == ["0002", "0003", "0004"]
    assert [interior.names[i] for i in asked[1]] == ["0004"]


@given(
    places=st.lists(st.tuples(*[st.floats(-0.5, 0.5)] * 3), min_size=2, max_size=8),
    moved=st.lists(st.tuples(*[st.floats(-0.5, 0.5)] * 3), min_size=8, max_size=8), fixed=st.lists(st.booleans(), min_size=8, max_size=8),
    seed=st.integers(0, 1),
)  # fmt: skip
def test_what_is_linked_is_found_pair_by_pair(
    places: list[tuple[float, float, float]], moved: list[tuple[float, float, float]], fixed: list[bool], seed: int
) -> None:
    interior = interior_of([("box", [block((0.2, 0.1, 0.1)), block((0.05, 0.3, 0.05))], yaw_pose(0.0, place)) for place in places])
    after = interior.poses.copy()
    after[:, :3, 3] = np.array(moved[: len(places)])
    beside = falling._beside(interior.solids, fixed[: len(places)], (interior.poses, after))
    graph = np.zeros_like(beside)
    for poses in (interior.poses, after):
        placed = [solid.placed(pose) for solid, pose in zip(interior.solids, poses, strict=True)]
        boxes = [[(hull.vertices.min(axis=0), hull.vertices.max(axis=0)) for hull in hulls] for hulls in placed]
        for i, j in np.ndindex(graph.shape):
            near = any((np.maximum(a[0], b[0]) <= np.minimum(a[1], b[1]) + falling.BESIDE_M).all() for a in boxes[i] for b in boxes[j])
            graph[i, j] |= i != j and not fixed[i] and not fixed[j] and near
    np.testing.assert_array_equal(beside, graph)
    _, labels = connected_components(graph, directed=False)
    assert falling._linked(beside, {seed}) == set(np.flatnonzero(labels == labels[seed]).tolist())


def test_two_that_lean_on_one_another_fall_together_or_not_at_all() -> None:
    interior, before, after = fallen(
        SLAB, leaning((0.03, 0.3, 0.3), 0.35, (-0.3, 0.0, 0.4)), leaning((0.03, 0.3, 0.3), -0.35, (0.3, 0.0, 0.4))
    )  # fmt: skip
    assert restless(before.certified) == {"0001", "0002"}
    assert restless(after.certified) == set()
    assert overlap(interior, after) <= Default().slop_m


def test_only_what_mujoco_sees_move_falls() -> None:
    """Other engines stay independent: none of their poses is taken."""
    interior, before, _ = fallen(leaning((0.1, 0.3, 0.3), 0.6, (0.0, 0.0, 0.0)))
    stands = [
        dataclasses.replace(row, is_stable_1cm=True, is_stable_5cm=True, is_stable_nudged=True, fallen_pose=None)
        if row.engine == "mujoco"
        else dataclasses.replace(row, engine="newton")
        for row in before.certified
    ]
    bodies, _ = bodies_of(interior, [], BodyConfig())
    made = let_fall(interior, before.poses, stands, bodies, {}, Default(), CertificateConfig())
    assert made.moves == ()


@pytest.mark.whole
@given(
    angles=st.lists(st.floats(-0.8, 0.8), min_size=1, max_size=3), widths=st.lists(st.floats(0.03, 0.2), min_size=3, max_size=3),
    yaw=st.floats(-3.0, 3.0),
)  # fmt: skip
def test_a_fall_never_makes_anything_worse(angles: list[float], widths: list[float], yaw: float) -> None:
    objects: list[Object] = [SLAB]
    for i, (angle, width) in enumerate(zip(angles, widths, strict=False)):
        category, parts, pose = leaning((width, 0.16, 0.2), angle, (0.35 * (i - 1), 0.0, 0.4))
        objects.append((category, parts, yaw_pose(yaw, [0.0, 0.0, 0.0]) @ pose))
    interior, before, after = fallen(*objects)
    start = overlap(interior, before)
    assume(start < 0.001)
    assert restless(after.certified) <= restless(before.certified)
    assert (not after.moves) or restless(after.certified) < restless(before.certified)
    assert overlap(interior, after) <= max(Default().slop_m, start)
    for i, pose in enumerate(after.poses):
        way = pose[:3, 3] - interior.poses[i][:3, 3]
        assert np.hypot(way[0], way[1]) <= Default().most_way_m
        assert abs(way[2]) <= Default().most_way_m
        np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-9)


@pytest.mark.parametrize("sides", [16, 40])
def test_what_rolls_on_over_the_edge_keeps_its_place(sides: int) -> None:
    roller = trimesh.creation.cylinder(0.03, 0.3, sections=sides)
    roller.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    roller.apply_translation([0.0, 0.0, 0.03 * np.cos(np.pi / sides)])
    _, before, after = fallen(SLAB, ("bottle", [roller], yaw_pose(0.0, [0.612, 0.0, 0.4])))
    assert restless(before.certified) == {"0001"}
    assert after.moves == ()
