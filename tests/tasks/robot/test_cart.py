"""A cart on wheels in the exported MuJoCo scene: how far it gets, what it runs into, and that it is the planar one but for physics."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from tasks.exports import ExportsConfig
from tasks.exports.bodies import Replica
from tasks.exports.mjcf import mjcf_files
from tasks.geometry.transforms import pose_from_quaternion_wxyz, translation, yaw_pose
from tasks.robot.bodies import CartBody, PlanarBody, Slip
from tasks.robot.cart import MujocoBody, cart_model, scene_text
from tasks.robot.configuration import Cart, DriveNoise, Lidar
from tasks.robot.displaced import PlanarMotion, moved_poses
from tasks.robot.drive import body_speeds
from tasks.robot.floor_map import floor_of
from tests.replicas import Object, cube, furnished, replica_of, rows_of
from tests.tasks.robot.floors import QUIET

CART = Cart()
STEP = 0.01
START = (-2.0, -1.0, 0.0)


def room(*objects: Object) -> Replica:
    return replica_of(*rows_of([cube((0.3, 0.3, 0.3), yaw_pose(0.3, (2.0, 0.2, 0.0))), *objects]))


def model_of(replica: Replica, **rest: Any) -> Any:
    return cart_model(scene_text(replica, ExportsConfig()), CART, **rest)


@pytest.fixture(scope="module")
def bare() -> Any:
    return model_of(room())


def driven(
    model: Any, v: float, w: float, seconds: float, pose: Sequence[float] = START, noise: DriveNoise = QUIET, seed: int = 0
) -> MujocoBody:
    """After so long with one command, and another second without."""
    cart = MujocoBody(model, CART, noise, pose, np.random.default_rng(seed))
    for index in range(round((seconds + 1) / STEP)):
        cart.drive(*((v, w) if index * STEP < seconds - 1e-9 else (0.0, 0.0)))
        cart.step(STEP)
    return cart


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_it_drives_straight_and_stands(bare: Any, yaw: float) -> None:
    cart = driven(bare, 0.4, 0.0, 2.5, (-2.0, -1.0, yaw))
    x, y, turned = cart.pose - [-2.0, -1.0, yaw]
    along, across = x * math.cos(yaw) + y * math.sin(yaw), y * math.cos(yaw) - x * math.sin(yaw)
    assert along == pytest.approx(1.0, rel=0.02)
    assert abs(across) < 0.001
    assert abs(turned) < 0.001
    assert cart.speeds == pytest.approx((0.0, 0.0), abs=0.002)
    assert cart.touched is None


@pytest.mark.parametrize("sign", [1, -1])
def test_it_turns_in_place(bare: Any, sign: int) -> None:
    cart = driven(bare, 0.0, sign * 0.9, 0.5 * math.pi / 0.9)
    assert cart.pose[2] == pytest.approx(sign * math.pi / 2, rel=0.03)
    assert cart.pose[:2] == pytest.approx(START[:2], abs=0.003)


def test_the_yaw_goes_on_beyond_half_a_turn(bare: Any) -> None:
    assert driven(bare, 0.0, 1.0, 7.0).pose[2] == pytest.approx(7.0, rel=0.03)


def test_it_backs_up(bare: Any) -> None:
    assert driven(bare, -0.15, 0.0, 2.0, (0.0, 0.0, 0.0)).pose == pytest.approx([-0.3, 0.0, 0.0], abs=0.006)


def test_it_runs_into_walls_and_things_and_says_so(bare: Any) -> None:
    cart = driven(bare, 0.5, 0.0, 4.0, (-2.0, -1.0, math.pi))
    assert cart.touched == "wall_05"
    assert cart.pose[0] == pytest.approx(-3.0 + CART.radius_m, abs=0.005)
    before = cart.pose
    cart.drive(0.5, 0.0)
    for _ in range(100):
        cart.step(STEP)
    assert cart.pose == pytest.approx(before, abs=0.005), "its motors hold it"
    assert driven(bare, 0.5, 0.0, 6.0, (0.0, 0.2, 0.0)).touched == "0001"


def test_readings_are_of_wheels_before_they_slip_and_of_the_true_turn(bare: Any) -> None:
    noise = dataclasses.replace(QUIET, slip=0.1)
    cart = MujocoBody(bare, CART, noise, START, np.random.default_rng(1))
    shares = Slip(noise, np.random.default_rng(1).spawn(2)[0]).shares
    read, turned, travelled = 0.0, 0.0, 0.0
    for _ in range(300):
        cart.drive(0.3, 0.2)
        before = cart.pose
        cart.step(STEP)
        read += float(body_speeds(*cart.wheel_readings(), CART)[0]) * STEP
        turned += cart.gyro_reading() * STEP
        travelled += float(np.hypot(*(cart.pose - before)[:2]))
    assert read == pytest.approx(0.3 * (3.0 - 0.3), rel=0.02), "a ramp of 0.6 s costs half of its time"
    assert turned == pytest.approx(cart.pose[2], abs=0.005)
    assert travelled / read == pytest.approx(shares.mean(), abs=0.005), "and the floor sees less or more of it"
    assert abs(shares - 1.0).max() > 0.02


@pytest.mark.parametrize("seed", [2, 5])
def test_it_goes_where_the_planar_one_goes_by_the_same_seed(bare: Any, seed: int) -> None:
    noise = DriveNoise()
    floor = floor_of(room(), CART, Lidar(), {})
    carts: list[CartBody] = [
        MujocoBody(bare, CART, noise, START, np.random.default_rng(seed)),
        PlanarBody(CART, noise, floor, START, np.random.default_rng(seed)),
    ]
    for index in range(600):
        for cart in carts:
            cart.drive(0.3, 0.4 * math.sin(index / 80))
            cart.step(STEP)
    assert np.hypot(*(carts[1].pose[:2] - START[:2])) > 1.0
    assert carts[0].pose == pytest.approx(carts[1].pose, abs=0.02)
    np.testing.assert_allclose(carts[0].wheel_readings(), carts[1].wheel_readings(), rtol=0.06)


def test_the_same_seed_gives_the_same_track(bare: Any) -> None:
    poses = [driven(bare, 0.4, 0.3, 2.0, noise=DriveNoise(), seed=seed).pose.tolist() for seed in (3, 3, 4)]
    assert poses[0] == poses[1] != poses[2]


def test_rugs_are_driven_over_and_doors_are_open() -> None:
    rug = dataclasses.replace(cube((0.5, 1.0, CART.covering_m - 0.002), translation((-1.0, -1.0, 0.0))), category="rug")
    door = Object("door", *[cube((0.05, 0.9, 2.0), np.eye(4)).parts] * 2, pose=translation((-0.2, -1.0, 0.0)))
    sill = cube((0.1, 0.5, CART.climb_m + 0.003), translation((0.6, -1.0, 0.0)))
    for is_free in (False, True):
        model = model_of(room(rug, door, sill), is_free=is_free)
        assert driven(model, 0.5, 0.0, 2.0).pose[0] == pytest.approx(-1.0, abs=0.02)
        cart = driven(model, 0.5, 0.0, 6.0)
        assert cart.touched == "0004"
        assert 0.55 - CART.radius_m - 0.005 < cart.pose[0] < (0.45 if is_free else 0.55 - CART.radius_m + 0.02)


def test_things_stand_fast_unless_they_may_be_pushed() -> None:
    box = cube((0.2, 0.2, 0.3), translation((0.0, -1.0, 0.0)), mass_kg=0.5)
    for is_free, is_pushed in ((False, False), (True, True)):
        model = model_of(room(box), is_free=is_free)
        cart = driven(model, 0.5, 0.0, 4.0)
        assert cart.touched == "0002"
        assert bool(cart._data.body("0002").xpos[0] > 0.005) is is_pushed


def test_the_scene_is_as_it_is_exported_but_for_looks_and_what_was_moved() -> None:
    replica = replica_of(*rows_of(furnished()))
    exported = next(file.data for file in mjcf_files(replica, ExportsConfig()) if file.role == "scene").decode()
    motions = {name: PlanarMotion(0.3, -0.2, 0.4, -1.5, 0.5) for name in ("0001", "0004")}
    for given, expected in (({}, replica), (motions, moved_poses(replica, motions))):
        models = [cart_model(text, CART, given) for text in (exported, scene_text(replica, ExportsConfig()))]
        assert models[0].ngeom == models[1].ngeom
        np.testing.assert_array_equal(models[0].mesh_vert, models[1].mesh_vert)
        for body in expected.bodies:
            for model in models:
                placed = model.body(body.instance_id)
                np.testing.assert_allclose(pose_from_quaternion_wxyz(placed.quat, placed.pos), body.pose, atol=1e-9)
                assert placed.geomnum[0] == len(body.shape.hulls)
