"""Certificates by MuJoCo: what rests is stable, what falls or tips is not, by how much, and whose fault it is."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from schemas.optimization import Certificate
from schemas.record import check, table_of
from tasks.captions.physics import attributes, mass, materials
from tasks.furniture import CATEGORIES, generate
from tasks.geometry.pieces import Hull, PieceConfig, convex_hull, pieces
from tasks.geometry.transforms import inverse, translation, yaw_pose
from tasks.optimization.certificates import (
    FAR_TILT_RADIANS,
    NEAR_M,
    CertificateConfig,
    Certified,
    _certified,
    certificate_rows,
    certify,
    density_bounds,
)
from tasks.optimization.engines.mujoco_engine import Mujoco, Simulation
from tasks.optimization.engines.newton_engine import Newton
from tasks.optimization.solids import ConvexParts, RigidBody, shell_solids
from tests.conftest import REPOSITORY
from tests.replicas import room_of

Array = np.ndarray
CONFIG = CertificateConfig(mujoco_defaults=False, nudge_m_s=0.0)
"""One engine, left alone."""


def box(size: Sequence[float], center: Sequence[float] | None = None) -> Hull:
    """A box, by default with its bottom center in the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    return convex_hull(corners + ([0, 0, size[2] / 2] if center is None else center), PieceConfig())


def body(name: str, *hulls: Hull, mass_kg: float = 1.0, friction: float = 0.5, is_fixed: bool = False) -> RigidBody:
    return RigidBody(ConvexParts(name, hulls), mass_kg, friction, ("wood",), is_fixed)


def cube(name: str, side: float = 0.3, **rest: float) -> RigidBody:
    return body(name, box((side, side, side)), **rest)


def rolled(angle: float, offset: Sequence[float]) -> Array:
    """Pose that turns about +X [rad], then moves."""
    pose = translation(offset)
    c, s = np.cos(angle), np.sin(angle)
    pose[1:3, 1:3] = [[c, -s], [s, c]]
    return pose


def of(*placed: tuple[RigidBody, Array], shell: Sequence[ConvexParts] = (), config: CertificateConfig = CONFIG) -> list[Certified]:
    found = certify([obj for obj, _ in placed], np.array([pose for _, pose in placed]), shell, config)
    assert [one.name for one in found] == [obj.solid.name for obj, _ in placed]
    return found


def test_a_box_on_the_floor_rests() -> None:
    (one,) = of((cube("0001"), yaw_pose(0.3, [1.0, -2.0, 0.0])))
    assert one.displacement_m < 1e-4
    assert one.tilt_radians < 1e-4
    assert one.start_penetration_m < 1e-6
    assert one.is_stable_1cm
    assert one.is_stable_5cm
    assert one.problem is None
    assert (one.engine, one.simulated_seconds) == ("mujoco", pytest.approx(2.0))


@pytest.mark.parametrize(("height", "stable_1cm", "stable_5cm"), [(0.0, True, True), (0.03, False, True), (0.5, False, False)])
def test_a_box_in_the_air_falls_by_its_height(height: float, stable_1cm: bool, stable_5cm: bool) -> None:
    (one,) = of((cube("0001"), translation([0, 0, height])))
    assert one.displacement_m == pytest.approx(height, abs=2e-4)
    assert one.settled_pose[2, 3] == pytest.approx(0.0, abs=2e-4)
    assert (one.is_stable_1cm, one.is_stable_5cm) == (stable_1cm, stable_5cm)


def test_a_box_on_its_edge_tips_over() -> None:
    angle = np.deg2rad(40.0)  # on an edge, its center 5 degrees from above it
    start = rolled(angle, [0.0, 0.0, 0.0])
    start[2, 3] = -(box((0.3, 0.3, 0.3)).transformed(start).vertices[:, 2].min())
    (one,) = of((cube("0001"), start))
    assert one.tilt_radians == pytest.approx(angle, abs=0.02), "it falls back onto its bottom"
    assert not one.is_stable_5cm


@given(st.floats(0.1, 1.0), st.floats(0.001, 0.05), st.floats(-np.pi, np.pi))
@settings(max_examples=25, deadline=None)
def test_start_penetration_is_the_depth(side: float, depth: float, yaw: float) -> None:
    turn = yaw_pose(yaw)
    lower, upper = cube("0001", side), cube("0002", side)
    found = of((lower, turn), (upper, turn @ translation([side / 3, 0, side - depth])))
    assert [one.start_penetration_m for one in found] == pytest.approx([depth, depth], abs=1e-5)
    (sunk,) = of((lower, turn @ translation([0, 0, -depth])))
    assert sunk.start_penetration_m == pytest.approx(depth, abs=1e-5)


def test_two_centimeters_are_seen_between_pieces_of_any_kind() -> None:
    pillar = body("0001", box((0.3, 0.3, 0.3)), is_fixed=True)
    for other in (cube("0002"), dataclasses.replace(cube("0002"), is_fixed=True)):
        found = of((pillar, np.eye(4)), (other, translation([0.28, 0.05, 0.0])))
        assert [one.start_penetration_m for one in found] == pytest.approx([0.02, 0.02], abs=5e-4), "fixed or not"
    sunk = of((dataclasses.replace(pillar), translation([0, 0, -0.02])))[0]
    assert sunk.start_penetration_m == pytest.approx(0.02, abs=5e-4)
    walls = shell_solids(room_of())
    beside = translation([-3.0 + 0.15 - 0.02, 0.0, 0.0])
    for obj in (cube("0001"), pillar):
        assert of((obj, beside), shell=walls)[0].start_penetration_m == pytest.approx(0.02, abs=5e-4)


def test_a_stack_rests() -> None:
    found = of(*((cube(f"{i:04d}", 0.2), yaw_pose(0.2 * i, [0.02 * (i % 2), 0, 0.2 * i])) for i in range(5)))
    assert max(one.displacement_m for one in found) < 1e-3
    assert all(one.is_stable_1cm and one.is_stable_5cm for one in found)


def table() -> RigidBody:
    """An L-shaped table top on five legs."""
    legs = [box((0.05, 0.05, 0.7), (x, y, 0.35)) for x, y in ((-0.6, -0.6), (0.6, -0.6), (0.6, 0.0), (-0.6, 0.6), (0.0, 0.6))]
    return body("0001", box((1.3, 0.65, 0.04), (0, -0.325, 0.72)), box((0.65, 0.65, 0.04), (-0.325, 0.325, 0.72)), *legs, mass_kg=20.0)


@given(st.floats(0.02, 5.0), st.floats(1.0, 100.0))
@settings(max_examples=20, deadline=None)
def test_the_heavy_rests_on_the_light(kg: float, ratio: float) -> None:
    plate = body("0001", box((0.4, 0.4, 0.01)), mass_kg=kg)
    found = of((plate, np.eye(4)), (cube("0002", 0.3, mass_kg=kg * ratio), translation([0, 0, 0.01])))
    assert max(one.displacement_m for one in found) < 1.5e-3


@given(st.floats(0.001, 0.01))
@settings(max_examples=10, deadline=None)
def test_a_small_overlap_is_pushed_apart_not_shot_away(depth: float) -> None:
    (one,) = of((cube("0001"), translation([-3.0 + 0.15 - depth, 0.0, 0.0])), shell=shell_solids(room_of()))
    assert depth * 0.9 < one.displacement_m < depth * 1.2


def test_a_table_of_pieces_rests_with_what_is_on_it_and_under_it() -> None:
    found = of(
        (table(), np.eye(4)), (cube("0002", 0.3), translation([-0.3, 0.4, 0.74])), (cube("0003", 0.5), translation([0.3, -0.3, 0.0]))
    )
    assert max(one.displacement_m for one in found) < 2e-4
    beside = of((table(), np.eye(4)), (cube("0002", 0.3), translation([0.4, 0.4, 0.74])))[1]
    assert beside.displacement_m > 0.5, "nothing is in the corner of the L"


@given(st.floats(0.02, 0.14), st.booleans())
@settings(max_examples=20, deadline=None)
def test_an_object_stays_on_a_shelf_when_its_center_does(offset: float, outside: bool) -> None:
    shelf = body("0001", box((0.6, 0.6, 0.6)), is_fixed=True)
    obj = cube("0002", 0.3)
    one = of((shelf, np.eye(4)), (obj, translation([0.3 + (offset if outside else -offset), 0, 0.6])))[1]
    assert one.is_stable_1cm == one.is_stable_5cm == (not outside)
    assert (one.tilt_radians > np.deg2rad(5.0)) == outside


def test_inertia_is_that_of_the_union_not_of_the_sum() -> None:
    beam = box((0.9, 0.2, 0.1), (0.15, 0, 0.05))  # reaches 0.3 m behind the edge, 0.6 m beyond it
    counter = box((0.2, 0.2, 0.3), (-0.2, 0, 0.25))
    shelf = body("0001", box((1.0, 1.0, 0.5)), is_fixed=True)
    pose = translation([0.5, 0, 0.5])  # the shelf ends at x = 0 of the object
    balance = 0.9 * 0.2 * 0.1 * 0.15 - 0.2 * 0.2 * 0.3 * 0.2
    assert balance > 0, "its center is beyond the edge"
    assert not of((shelf, np.eye(4)), (body("0002", beam, counter), pose))[1].is_stable_1cm
    twice = of((shelf, np.eye(4)), (body("0002", beam, counter, counter), pose))[1]
    assert not twice.is_stable_1cm, "the same material twice is no counterweight"
    bigger = box((0.2, 0.2, 0.5), (-0.2, 0, 0.35))
    assert of((shelf, np.eye(4)), (body("0002", beam, bigger), pose))[1].is_stable_1cm


def test_fixed_objects_do_not_move_at_all() -> None:
    pose = yaw_pose(0.123456789, [0.1, 0.2, 1.5]) @ rolled(0.3, [0, 0, 0])
    hung, fallen = of((body("0001", box((0.3, 0.3, 0.3)), is_fixed=True), pose), (cube("0002"), translation([2, 0, 1.5])))
    assert hung.settled_pose.tobytes() == pose.tobytes()
    assert (hung.displacement_m, hung.tilt_radians) == (0.0, 0.0)
    assert hung.is_stable_1cm
    assert hung.is_stable_5cm
    assert not fallen.is_stable_5cm


def test_a_wall_stops_what_leans_on_it() -> None:
    board = body("0001", box((0.02, 0.5, 1.0)), friction=0.8)
    lean = np.deg2rad(10.0)
    pose = np.eye(4)  # its upper edge at the wall x = -3, its foot 0.17 m in front
    c, s = np.cos(lean), np.sin(lean)
    pose[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    points = board.solid.placed(pose)[0].vertices
    pose[:3, 3] = [-3.0 - points[:, 0].min() + 1e-4, 0.0, -points[:, 2].min()]
    with_wall, without = of((board, pose), shell=shell_solids(room_of()))[0], of((board, pose))[0]
    assert with_wall.is_stable_1cm
    assert without.tilt_radians > np.deg2rad(30.0)


def scene() -> list[tuple[RigidBody, Array]]:
    """Objects at rest, in the air, in each other and fixed."""
    placed = [(table(), np.eye(4)), (cube("0002"), translation([-0.3, 0.4, 0.75])), (cube("0003"), translation([0.3, -0.5, 0.73]))]
    placed += [(cube(f"{i:04d}", 0.2), yaw_pose(i, [1.5, 0.0, 0.21 * (i - 4)])) for i in range(4, 9)]
    return [*placed, (dataclasses.replace(cube("0009"), is_fixed=True), translation([0, 0, 2.0]))]


ELSEWHERE = """
import hashlib, os, sys
from tests.tasks.optimization.test_certificates import in_bytes, of, scene
found = of(*scene())
assert not {"OpenGL", "glfw"} & sys.modules.keys() and "prefect" not in sys.modules
print(os.environ["MUJOCO_GL"], hashlib.sha256(b"".join(map(in_bytes, found))).hexdigest())
"""


@pytest.mark.whole
@pytest.mark.parametrize(("chosen", "taken"), [(None, "disable"), ("off", "off")])
def test_every_process_finds_the_same_and_needs_no_window_system(chosen: str | None, taken: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"} | ({"MUJOCO_GL": chosen} if chosen else {})
    done = subprocess.run([sys.executable, "-c", ELSEWHERE], cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [taken, hashlib.sha256(b"".join(map(in_bytes, of(*scene())))).hexdigest()]


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize("name", ["timestep_s", "sleep_m_s"])
def test_verdicts_do_not_hang_on_numerics(name: str, furniture: list[Certified]) -> None:
    finer = {"timestep_s": 0.001, "sleep_m_s": 0.0}
    placed = collection()
    again = of(*placed, config=dataclasses.replace(CONFIG, mujoco=dataclasses.replace(Mujoco(), **{name: finer[name]})))
    for category, a, b in zip(CATEGORIES, furniture, again, strict=True):
        if abs(a.displacement_m - NEAR_M) > 5e-3 and abs(a.tilt_radians - FAR_TILT_RADIANS) > 0.02:
            assert (a.is_stable_1cm, a.is_stable_5cm) == (b.is_stable_1cm, b.is_stable_5cm), category


def in_bytes(one: Certified) -> bytes:
    numbers = [v for v in dataclasses.astuple(one) if isinstance(v, float)]
    return (b"" if one.settled_pose is None else one.settled_pose.tobytes()) + np.array(numbers).tobytes()


def says_nothing_of_the_end(one: Certified) -> bool:
    known = (one.settled_pose, one.displacement_m, one.tilt_radians, one.start_penetration_m)
    return all(value is None for value in known) and (one.is_stable_1cm, one.is_stable_5cm) == (False, False)


@given(st.permutations(range(len(scene()))))
@settings(max_examples=5, deadline=None)
def test_the_order_of_bodies_does_not_matter(order: Sequence[int]) -> None:
    straight, placed = of(*scene()), scene()
    mixed = of(*(placed[i] for i in order))
    assert [in_bytes(one) for one in mixed] == [in_bytes(straight[i]) for i in order]


@given(st.floats(-np.pi, np.pi), st.floats(-20, 20))
@settings(max_examples=5, deadline=None)
def test_verdicts_do_not_depend_on_where_the_scene_is(yaw: float, x: float) -> None:
    moved = yaw_pose(yaw, [x, -3.0, 0.0])
    here, there = of(*scene()), of(*((obj, moved @ pose) for obj, pose in scene()))
    assert [(a.is_stable_1cm, a.is_stable_5cm) for a in here] == [(b.is_stable_1cm, b.is_stable_5cm) for b in there]
    for a, b in zip(here, there, strict=True):
        if a.is_stable_1cm:
            assert inverse(moved) @ b.settled_pose == pytest.approx(a.settled_pose, abs=1e-3)


@pytest.mark.parametrize("scale", [0.05, 0.3, 3.0])
def test_verdicts_at_every_size(scale: float) -> None:
    small = [
        (body(name, box(np.full(3, 0.4 * scale)), mass_kg=50 * scale**3), translation([0, 0, 0.4 * scale * i]))
        for i, name in enumerate(["0001", "0002", "0003"])
    ]
    assert all(one.is_stable_1cm and one.displacement_m < 2e-3 for one in of(*small))


@given(
    st.lists(
        st.tuples(st.floats(0.03, 1.5), st.floats(0.03, 1.5), st.floats(0.01, 1.5), st.floats(-np.pi, np.pi), st.floats(0.05, 200.0)),
        min_size=1, max_size=6,
    )
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_boxes_on_the_floor_are_stable(boxes: list[tuple[float, float, float, float, float]]) -> None:
    placed = [
        (body(f"{i:04d}", box((x, y, z)), mass_kg=kg), yaw_pose(yaw, [2.5 * i, 0.0, 0.0])) for i, (x, y, z, yaw, kg) in enumerate(boxes)
    ]
    for one in of(*placed):
        assert one.is_stable_1cm
        assert one.is_stable_5cm
        assert one.displacement_m < 1e-3
        assert one.start_penetration_m < 1e-5


FLAT = Hull(
    np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64), np.array([[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 3, 2]])
)
REFUSED = {
    "flat": body("0002", FLAT),
    "no pieces": body("0002"),
    "no triangle": body("0002", Hull(np.zeros((1, 3)), np.zeros((0, 3), dtype=np.int64))),
    "not finite": body("0002", Hull(np.where(FLAT.vertices == 1, np.nan, 0.0), FLAT.faces)),
    "a point": body("0002", Hull(box((1, 1, 1)).vertices * 1e-9, box((1, 1, 1)).faces)),
    "inside out": body("0002", Hull(box((1, 1, 1)).vertices, box((1, 1, 1)).faces[:, ::-1])),
    "one bad piece": body("0002", box((1, 1, 1)), FLAT),
    "no mass": cube("0002", mass_kg=0.0),
    "mass unknown": cube("0002", mass_kg=float("nan")),
}


@pytest.mark.parametrize("bad", REFUSED.values(), ids=REFUSED)
@pytest.mark.parametrize("is_fixed", [False, True])
def test_what_the_engine_refuses_is_reported_and_the_others_are_certified(bad: RigidBody, is_fixed: bool) -> None:
    refused = dataclasses.replace(bad, is_fixed=is_fixed)
    pose = translation([2.0, 0.0, 0.3])
    good, one, above = of((cube("0001"), np.eye(4)), (refused, pose), (cube("0003"), translation([0, 0, 0.8])))
    assert one.problem
    assert says_nothing_of_the_end(one)
    assert good.problem is None
    assert good.is_stable_1cm
    assert above.displacement_m == pytest.approx(0.5, abs=5e-4), "it falls onto the first"
    rows = certificate_rows("demo/room", [good, one, above])
    check(rows, Certificate)
    assert [row.problem for row in rows] == [None, one.problem, None]
    assert [row.settled_pose is None for row in rows] == [False, True, False]
    assert rows[1].is_density_plausible is None or rows[1].density_kg_m3 > 0.0


@pytest.mark.parametrize("thin", [1e-4, 1e-3])
def test_thin_and_tiny_objects_are_no_trouble(thin: float) -> None:
    sheet, crumb = body("0001", box((0.3, 0.2, thin)), mass_kg=0.01), body("0002", box(np.full(3, 5 * thin)), mass_kg=1e-4)
    for one in of((sheet, np.eye(4)), (crumb, translation([1, 0, 0]))):
        assert one.problem is None
        assert one.is_stable_1cm


@pytest.mark.parametrize("steps", [1, 5, 500])
def test_a_state_that_diverges_is_no_rest(steps: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lost = translation([1e11, 0.0, 0.0])
    config = dataclasses.replace(CONFIG, mujoco=Mujoco(check_steps=steps))
    near, far = of((cube("0001"), np.eye(4)), (cube("0002"), lost), config=config)
    assert far.problem
    assert "diverges" in far.problem
    assert says_nothing_of_the_end(far)
    assert far.density_kg_m3 == pytest.approx(near.density_kg_m3), "what no engine is needed for is known"
    assert in_bytes(near) == in_bytes(of((cube("0001"), np.eye(4)))[0])
    assert list(tmp_path.iterdir()) == [], "no log file is left behind"


def test_input_that_means_nothing_is_refused() -> None:
    one = cube("0001")
    for pose in (np.full((4, 4), np.nan), np.diag([2.0, 1.0, 1.0, 1.0])):
        with pytest.raises(InputError, match="0001 optimized_pose"):
            of((one, pose))
    with pytest.raises(InputError, match="2 bodies, 1 names"):
        of((one, np.eye(4)), (one, translation([1, 0, 0])))
    with pytest.raises(InputError, match="unobtainium"):
        of((dataclasses.replace(one, materials=("unobtainium",)), np.eye(4)))
    assert certify([], np.zeros((0, 4, 4)), (), CONFIG) == []


def bounds_of(*words: str) -> tuple[float, float]:
    bounds = density_bounds(words)
    assert bounds is not None
    return bounds


def test_without_a_material_there_is_no_verdict_on_the_density() -> None:
    (one,) = of((dataclasses.replace(cube("0001", 0.3, mass_kg=0.001), materials=()), np.eye(4)))
    assert (one.density_low_kg_m3, one.density_high_kg_m3, one.is_density_plausible) == (None, None, None)
    assert one.density_kg_m3 == pytest.approx(0.001 / 0.027)
    (row,) = certificate_rows("demo/room", [one])
    check([row], Certificate)
    assert row.is_density_plausible is None


def test_the_bounds_of_the_density_are_those_that_the_columns_name() -> None:
    columns = {column.name: column.description for column in table_of(Certificate).columns}
    for name, material in materials().items():
        percent = 0.4 if name in ("fabric", "foliage") else 1.0
        assert bounds_of(name)[0] == pytest.approx(material.density_min_kg_m3 * percent / 100)
        assert f"{percent:g} %" in columns["density_low_kg_m3"]


def test_turning_about_the_upright_axis_is_no_tilt_and_both_verdicts_look_at_the_tilt() -> None:
    turned = Simulation("mujoco", "0", 2.0, np.array([yaw_pose(2.0)]), np.zeros(1), (None,))
    one = _certified(cube("0001"), np.eye(4), turned, 0)
    assert one.tilt_radians == pytest.approx(0.0, abs=1e-12)
    assert (one.is_stable_1cm, one.is_stable_5cm) == (True, True)
    leaning = dataclasses.replace(turned, settled=np.array([rolled(0.5, (0.0, 0.0, 0.0))]))
    one = _certified(cube("0001"), np.eye(4), leaning, 0)
    assert one.tilt_radians == pytest.approx(0.5)
    assert (one.is_stable_1cm, one.is_stable_5cm) == (False, False)


def test_what_balances_on_an_edge_falls_after_a_nudge_and_what_stands_does_not() -> None:
    stands = (cube("0002"), yaw_pose(0.4, [2.0, 0.0, 0.0]))
    board = (
        body("0001", box((0.4, 0.04, 0.4))),
        translation((0.0, 0.0, 0.0)),
    )  # on its edge: 2 cm to each edge, which a nudge of 0.05 m/s cannot overcome
    for one in of(stands, board, config=CertificateConfig(mujoco_defaults=False)):
        assert (one.is_stable_1cm, one.is_stable_5cm, one.is_stable_nudged) == (True, True, True)
        assert one.nudged_displacement_m is not None
        assert one.displacement_m is not None
        assert one.displacement_m < one.nudged_displacement_m < 0.01
    thin = body("0003", box((0.4, 0.005, 0.4))), translation((0.0, 0.0, 0.0))  # 2.5 mm to each edge
    rows = of(thin, config=CertificateConfig(mujoco_defaults=False))
    assert [(one.is_stable_1cm, one.is_stable_5cm, one.is_stable_nudged) for one in rows] == [(True, True, False)]
    assert rows[0].nudged_tilt_radians is not None
    assert rows[0].nudged_tilt_radians > 1.0


def test_mujocos_own_defaults_certify_beside_the_shipped_settings() -> None:
    placed = [(cube("0002"), yaw_pose(0.4, [2.0, 0.0, 0.0])), (cube("0001"), translation((0.0, 0.0, 0.5)))]
    config = CertificateConfig()
    rows = certify([obj for obj, _ in placed], np.array([pose for _, pose in placed]), (), config)
    assert [(row.name, row.engine) for row in rows] == [
        (name, engine) for engine in ("mujoco", "mujoco_defaults") for name in ("0002", "0001")
    ]
    assert [row.is_stable_5cm for row in rows] == [True, False, True, False]
    assert len({tuple(row.settled_pose.ravel()) for row in rows if row.settled_pose is not None}) == 4, "each solver has its own ends"
    without = certify([obj for obj, _ in placed], np.array([pose for _, pose in placed]), (), CONFIG)
    for plain, nudged in zip(without, rows[:2], strict=True):
        assert plain.is_stable_nudged is plain.nudged_displacement_m is plain.nudged_tilt_radians is None
        np.testing.assert_array_equal(plain.settled_pose, nudged.settled_pose)


def test_a_fixed_object_withstands_every_nudge() -> None:
    hung = dataclasses.replace(cube("0001"), is_fixed=True), translation((0.0, 0.0, 1.0))
    (one, other) = certify([hung[0]], hung[1][None], (), CertificateConfig())
    assert (one.is_stable_nudged, one.nudged_displacement_m, one.nudged_tilt_radians) == (True, 0.0, 0.0)
    assert other.is_stable_nudged


@pytest.mark.parametrize("kind", [CertificateConfig, Mujoco, Newton])
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_settings_that_mean_nothing_are_refused_by_name(kind: type, data: st.DataObject) -> None:
    numbers = {field.name: field.default for field in dataclasses.fields(kind) if isinstance(field.default, int | float)}
    name = data.draw(st.sampled_from(sorted(numbers)))
    worse = [-1e-9, float("nan"), float("inf"), *([0.02, 1.0] if name == "timestep_s" else [])]
    bad = data.draw(st.sampled_from([-1, *(worse if isinstance(numbers[name], float) else [])]))
    with pytest.raises(ValueError, match=f"^{name}: must be [^\n]*$"):
        kind(**{name: bad})


def test_zero_is_refused_where_it_means_nothing() -> None:
    for name in ("timestep_s", "impratio", "stiffness_s", "friction_floor", "iterations", "memory_bytes", "check_steps"):
        with pytest.raises(ValueError, match=f"^{name}: "):
            Mujoco(**{name: 0})
    for name in ("timestep_s", "impratio", "stiffness", "friction_floor", "iterations", "xpbd_iterations", "timeout_s"):
        with pytest.raises(ValueError, match=f"^{name}: "):
            Newton(**{name: 0})
    for impedance in ((0.9, 0.99), (0.9, 1.0, 0.001), (0.0, 0.99, 0.001), (0.9, 0.99, 0.0)):
        with pytest.raises(ValueError, match=r"^impedance: "):
            Mujoco(impedance=impedance)  # type: ignore[arg-type]
    for seconds in (0.0, 0.003):
        with pytest.raises(ValueError, match=r"^seconds: must be "):
            CertificateConfig(seconds=seconds)
    with pytest.raises(ValueError, match=r"^solver: must be mujoco or xpbd, is 'bullet'$"):
        Newton(solver="bullet")  # type: ignore[arg-type]
    assert Mujoco(sleep_m_s=0.0, tolerance=0.0).sleep_m_s == 0.0
    assert not {"near_m", "far_m", "far_tilt_radians"} & {field.name for field in dataclasses.fields(CertificateConfig)}


def test_density_is_held_against_the_materials() -> None:
    for kg, plausible in ((0.001, False), (10.0, True), (100.0, False)):
        (one,) = of((cube("0001", 0.3, mass_kg=kg), np.eye(4)))
        assert one.solid_volume_m3 == pytest.approx(0.027)
        assert one.density_kg_m3 == pytest.approx(kg / 0.027)
        assert one.is_density_plausible == plausible
    for material in materials().values():
        low, high = bounds_of(material.name)
        assert low < material.density_min_kg_m3 <= material.density_kg_m3 <= material.density_max_kg_m3 == high
    low, high = bounds_of("cork", "metal")
    assert (low, high) == (bounds_of("cork")[0], bounds_of("metal")[1])


LOOSE = {"ceiling lamp", "clock", "desk lamp", "guitar", "headphones", "pillow", "towel"}
"""Drawn as they hang or lean, or round below: put on the floor, they tip."""


def collection() -> list[tuple[RigidBody, Array]]:
    """One object of every category on the floor, apart from each other."""
    placed = []
    for i, category in enumerate(CATEGORIES):
        model = generate(category, None, np.random.default_rng(i))
        hulls = pieces(model.parts, model.pieces, PieceConfig()).hulls
        size = np.ptp(np.concatenate([hull.vertices for hull in hulls]), axis=0)
        row = attributes(category, "unlabeled", size)
        words = tuple(word for word, _ in row.materials)
        obj = RigidBody(ConvexParts(f"{i:04d}", hulls), mass(row, words[0], size).mass_kg, row.friction, words, False)
        placed.append((obj, yaw_pose(i, [2.6 * (i % 12), 2.6 * (i // 12), 0.0])))
    return placed


@pytest.fixture(scope="module")
def furniture() -> list[Certified]:
    """Certificates of the collection."""
    return of(*collection())


@pytest.mark.whole
def test_generated_furniture_stands(furniture: list[Certified]) -> None:
    for category, one in zip(CATEGORIES, furniture, strict=True):
        assert one.problem is None, category
        assert one.start_penetration_m < 1e-5, category
        if category not in LOOSE:
            assert one.is_stable_1cm, (category, one.displacement_m)
            assert one.is_stable_5cm, (category, one.displacement_m, one.tilt_radians)


@pytest.mark.whole
def test_generated_furniture_is_as_heavy_as_its_materials_allow(furniture: list[Certified]) -> None:
    odd = [category for category, one in zip(CATEGORIES, furniture, strict=True) if not one.is_density_plausible]
    assert len(odd) <= len(CATEGORIES) // 20, odd
