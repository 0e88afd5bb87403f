"""Nudges: what sleeps after one is not computed, and that changes no verdict, neither in rooms nor on edges."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.captions.physics import attributes, mass
from tasks.furniture.rooms import ROOM_TYPES, furnish
from tasks.geometry.pieces import Hull, PieceConfig, convex_hull, pieces
from tasks.geometry.transforms import rotation_of, translation, yaw_pose
from tasks.optimization.certificates import CertificateConfig, Certified, certify
from tasks.optimization.engines import mujoco_engine
from tasks.optimization.engines.mujoco_engine import NUDGES, Mujoco
from tasks.optimization.solids import ConvexParts, RigidBody
from tasks.stage import in_turn

Array = np.ndarray
Placed = tuple[RigidBody, Array]

FAST, PLAIN = CertificateConfig(), CertificateConfig(nudge_sleep_m_s=0.0)
"""As certificates are made, and with everything computed to the end that the shipped settings would."""

LEFT_ALONE = ("settled_pose", "displacement_m", "tilt_radians", "start_penetration_m", "is_stable_1cm", "is_stable_5cm", "problem")


def certified(placed: list[Placed], config: CertificateConfig) -> list[Certified]:
    return certify([obj for obj, _ in placed], np.array([pose for _, pose in placed]), (), config)


def box(size: tuple[float, float, float]) -> Hull:
    """A box with its bottom center in the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)]) * size
    return convex_hull(corners, PieceConfig())


def body(name: str, size: tuple[float, float, float], mass_kg: float) -> RigidBody:
    return RigidBody(ConvexParts(name, (box(size),)), mass_kg, 0.5, ("wood",), False)


def hold_equal(fast: list[Certified], plain: list[Certified], most_apart_m: float) -> None:
    """The same verdicts, the same bits of what was left alone, and of what stays nudges that are no further apart than so [m]."""
    assert [(row.name, row.engine) for row in fast] == [(row.name, row.engine) for row in plain]
    for one, other in zip(fast, plain, strict=True):
        for field in LEFT_ALONE:
            np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
        assert one.is_stable_nudged == other.is_stable_nudged, (one, other)
        assert (one.fallen_pose is None) == (other.fallen_pose is None)
        if one.is_stable_nudged and one.nudged_displacement_m is not None:
            assert one.nudged_displacement_m == pytest.approx(other.nudged_displacement_m, abs=most_apart_m)


def room(kind: str, seed: int) -> list[Placed]:
    """A furnished room; of what stands free every fourth is lifted, and every other one of those is tilted, too."""
    rng = np.random.default_rng(seed)
    placed = []
    for i, item in enumerate(furnish(kind, rng, 22, clutter=0.5).objects):
        hulls = pieces(item.parts, item.pieces, PieceConfig()).hulls
        size = np.ptp(np.concatenate([hull.vertices for hull in hulls]), axis=0)
        row = attributes(item.category, "unlabeled", size)
        words = tuple(word for word, _ in row.materials)
        is_fixed = item.parent in ("wall", "ceiling")
        obj = RigidBody(ConvexParts(f"{i:04d}", hulls), mass(row, words[0], size).mass_kg, row.friction, words, is_fixed)
        pose = item.pose
        if i % 4 == 0 and not is_fixed:
            tilt = np.eye(4)
            tilt[:3, :3] = rotation_of([float(rng.uniform(0.2, 0.7)) * (i % 8 == 0), 0.0, 0.0])
            pose = translation([0.0, 0.0, float(rng.uniform(0.02, 0.12))]) @ pose @ tilt
        placed.append((obj, pose))
    return placed


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize(("kind", "seed"), [(kind, seed) for seed, kind in enumerate(ROOM_TYPES)])
def test_sleep_after_a_nudge_changes_no_verdict_in_a_room(kind: str, seed: int) -> None:
    placed = room(kind, seed)
    fast, plain = certified(placed, FAST), certified(placed, PLAIN)
    assert {row.is_stable_nudged for row in plain} == {True, False}, "there is something to be told apart"
    hold_equal(fast, plain, most_apart_m=0.002)


def test_sleep_after_a_nudge_changes_no_verdict_on_an_edge() -> None:
    """Boards on their edges, of which the thinnest fall at a nudge and the thickest do not."""
    widths = np.linspace(0.003, 0.03, 10)
    placed = [
        (body(f"{i:02d}{k}", (float(w), 0.3, height), 1.0), translation([2.0 * i, 3.0 * k, 0.0]))
        for i, w in enumerate(widths)
        for k, height in enumerate((0.2, 0.5, 1.2))
    ]
    fast, plain = certified(placed, FAST), certified(placed, PLAIN)
    for engine in ("mujoco", "mujoco_defaults"):
        assert {row.is_stable_nudged for row in plain if row.engine == engine} == {True, False}
    hold_equal(fast, plain, most_apart_m=0.002)


def elsewhere(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """What other processes make of copies of the items, the last one first."""
    return [pickle.loads(pickle.dumps(function(pickle.loads(pickle.dumps(item))))) for item in reversed(items)][::-1]


def test_runs_side_by_side_say_what_they_say_one_after_another() -> None:
    thin = [(body(f"{i:02d}", (0.004 + 0.004 * i, 0.3, 0.5), 1.0), translation([i, 0.0, 0.0])) for i in range(5)]
    bad = [(body("99", (0.2, 0.2, 0.2), float("nan")), translation([0.0, 3.0, 0.0]))]
    placed = [*thin, *bad]
    bodies, poses = [obj for obj, _ in placed], np.array([pose for _, pose in placed])
    alone, aside = (certify(bodies, poses, (), FAST, spread) for spread in (in_turn, elsewhere))
    assert {row.is_stable_nudged for row in alone} == {True, False}
    for one, other in zip(alone, aside, strict=True):
        for field in dataclasses.fields(Certified):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), err_msg=field.name)


def test_only_nudges_sleep_early(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is left alone sleeps as the exported file says, by both settings; where nothing sleeps, nothing does after a nudge."""
    asked: list[tuple[float, bool]] = []
    run = mujoco_engine._run

    def spied(model: Any, data: Any, steps: int, settings: Mujoco) -> tuple[list[int], str]:
        asked.append((float(model.opt.sleep_tolerance), bool(np.any(data.qvel))))
        return run(model, data, steps, settings)

    monkeypatch.setattr(mujoco_engine, "_run", spied)
    placed = [(body("0001", (0.2, 0.2, 0.2), 1.0), yaw_pose(0.2))]
    certified(placed, FAST)
    assert asked == [(1e-6, False), *[(1e-3, True)] * len(NUDGES)] * 2
    for config, tolerance in ((PLAIN, 1e-6), (dataclasses.replace(FAST, mujoco=Mujoco(sleep_m_s=0.01)), 0.01)):
        asked.clear()
        certified(placed, config)
        assert asked == [(tolerance, False), *[(tolerance, True)] * len(NUDGES)] * 2
    never = Mujoco(sleep_m_s=0.0)
    slow, fast = (certified(placed, CertificateConfig(mujoco=never, nudge_sleep_m_s=speed)) for speed in (0.0, 1.0))
    hold_equal(fast, slow, most_apart_m=0.0)


def test_what_was_put_to_sleep_is_woken_by_what_hits_it() -> None:
    """A light cup on a table sleeps after its nudge until a block that was dropped from high above throws it off."""
    table, cup, dropped = body("0000", (0.8, 0.8, 0.5), 20.0), body("0001", (0.06, 0.06, 0.1), 0.05), body("0002", (0.08, 0.08, 0.08), 5.0)
    placed = [(table, np.eye(4)), (cup, translation([0.3, 0.0, 0.5])), (dropped, translation([0.26, 0.0, 4.0]))]
    alone = {row.name: row.is_stable_nudged for row in certified(placed[:2], FAST) if row.engine == "mujoco"}
    hit = {row.name: row.is_stable_nudged for row in certified(placed, FAST) if row.engine == "mujoco"}
    assert alone == {"0000": True, "0001": True}
    assert hit["0001"] is False


def test_what_sleeps_from_the_start_stands_as_it_is_until_it_is_hit() -> None:
    """A block falls onto a cup that sleeps, and another cup sleeps through; where nothing ever sleeps, both are certified as ever."""
    cup, other, dropped = body("0000", (0.06, 0.06, 0.1), 0.05), body("0001", (0.06, 0.06, 0.1), 0.05), body("0002", (0.1, 0.1, 0.1), 5.0)
    bodies, poses = [cup, other, dropped], np.array([np.eye(4), translation([1.0, 0.0, 0.0]), translation([0.04, 0.0, 0.5])])
    rows = certify(bodies, poses, (), FAST, asleep=(0, 1))
    for row in rows:
        if row.name == "0001":
            assert (row.displacement_m, row.tilt_radians, row.nudged_displacement_m) == (0.0, 0.0, 0.0)
        else:
            assert row.displacement_m
            assert row.nudged_displacement_m
    never = dataclasses.replace(FAST, mujoco=Mujoco(sleep_m_s=0.0))
    for one, same in zip(certify(bodies, poses, (), never, asleep=(0, 1)), certify(bodies, poses, (), never), strict=True):
        np.testing.assert_array_equal(one.settled_pose, same.settled_pose)
        assert one.nudged_displacement_m == same.nudged_displacement_m


def test_both_settings_of_one_scene_say_what_each_says_alone() -> None:
    """A scene is compiled once for both, and may lose a body by one of them."""
    placed = [(body(f"{i:02d}", (0.01 + 0.02 * i, 0.3, 0.5), 1.0), translation([i, 0.0, 0.0])) for i in range(3)]
    placed.append((body("99", (0.2, 0.2, 0.2), float("nan")), translation([0.0, 3.0, 0.0])))
    bodies, poses = [obj for obj, _ in placed], np.array([pose for _, pose in placed])
    engines = {"one": Mujoco(), "other": Mujoco(cone="pyramidal", impratio=1.0, integrator="Euler"), "third": Mujoco(stiffness_s=0.03)}
    together = mujoco_engine.simulate_all(bodies, poses, (), 1.0, engines, 0.05, 0.001)
    for made, (name, engine) in zip(together, engines.items(), strict=True):
        alone = mujoco_engine.simulate(bodies, poses, (), 1.0, engine, 0.05, name, 0.001)
        for field in dataclasses.fields(alone):
            np.testing.assert_array_equal(getattr(made, field.name), getattr(alone, field.name), err_msg=field.name)


def test_a_run_may_end_where_all_sleep() -> None:
    """Looked at once, at its end, a run ends where it ends when it is looked at often and left as soon as everything sleeps."""
    placed = [(body(f"{i:02d}", (0.1 + 0.1 * i, 0.3, 0.3), 1.0), translation([i, 0.0, 0.001 * i])) for i in range(3)]
    bodies, poses = [obj for obj, _ in placed], np.array([pose for _, pose in placed])
    often, once = (mujoco_engine.simulate(bodies, poses, (), 2.0, Mujoco(check_steps=n), 0.05, nudged_sleep=0.001) for n in (1, 10_000))
    assert often.settled.tobytes() == once.settled.tobytes()
    assert often.nudged.tobytes() == once.nudged.tobytes()
    assert not np.array_equal(often.nudged[0], poses)


def plain_penetrations(bodies: Sequence[RigidBody], poses: np.ndarray) -> np.ndarray:
    """Deepest penetration of fixed bodies with one another and the floor, pair by pair [m]."""
    model = mujoco_engine._model(bodies, poses, (), [None] * len(bodies), Mujoco())
    mujoco = mujoco_engine.mujoco_module()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    depth = np.zeros(len(bodies))
    for i in range(len(bodies)):
        for a in np.flatnonzero(model.geom_bodyid == i + 1).tolist():
            depth[i] = max(depth[i], -float(mujoco_engine._world_vertices(model, data, a)[:, 2].min()))
            for b in np.flatnonzero((model.geom_bodyid != i + 1) & (model.geom_bodyid > 0)).tolist():
                depth[i] = max(depth[i], -float(mujoco.mj_geomDistance(model, data, min(a, b), max(a, b), 0.0, None)))
    return depth


@given(places=st.lists(st.tuples(*[st.floats(-0.3, 0.3)] * 2, st.floats(-0.05, 0.5), st.floats(-3.0, 3.0)), min_size=1, max_size=5))
@settings(max_examples=30)
def test_penetrations_of_fixed_bodies_are_those_of_all_pairs(places: list[tuple[float, float, float, float]]) -> None:
    bodies = [dataclasses.replace(body(f"{i:02d}", (0.1 + 0.1 * i, 0.2, 0.1), 1.0), is_fixed=True) for i in range(len(places))]
    poses = np.array([yaw_pose(yaw, [x, y, z]) for x, y, z, yaw in places])
    found = mujoco_engine.simulate(bodies, poses, (), 1.0, Mujoco()).start_penetration
    np.testing.assert_array_equal(found, plain_penetrations(bodies, poses))
    assert not np.signbit(found).any()


def test_a_scene_is_packed_once_for_all_its_runs() -> None:
    scenes: list[bytes] = []

    def packing(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        scenes.extend(item.scene.__reduce__()[1][0] for item in items)
        return elsewhere(function, items)

    certify([body("0001", (0.2, 0.2, 0.2), 1.0)], np.eye(4)[None], (), FAST, packing)
    assert len(scenes) == 2 * (1 + len(NUDGES))
    assert len({id(scene) for scene in scenes}) == 1
