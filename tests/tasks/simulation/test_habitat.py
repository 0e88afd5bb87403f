"""habitat-sim behind the protocol: frames and quaternions there and back, and the same ways as our own simulator, on a stand-in of it."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.evaluation.measures import path_finder
from tasks.exports.habitat import rotation, scene_handle
from tasks.simulation.configuration import SimulationConfig
from tasks.simulation.habitat import HabitatSimulator, rotation_of, yaw_from
from tasks.simulation.protocol import NO_OBJECT
from tasks.simulation.simulator import WorldSimulator
from tasks.simulation.world import World, view_points
from tests.tasks.simulation import habitat_sim_stand_in as stand_in
from tests.tasks.simulation.acted_scenes import LIVING, STUDY, acted_scene
from tests.tasks.simulation.test_agents import StandInCamera

CONFIG = SimulationConfig(width=8, height=6)


@pytest.fixture
def simulator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> HabitatSimulator:
    scenes = {
        scene_handle(scene_id): (
            path_finder(acted_scene(scene_id).navmesh, "a.navmesh"),
            {"chair_:0000": {"instance_id": "0002", "nyu40_id": 5}, "shelf_:0000": {"instance_id": "0000"}, "rug_:0000": {}},
        )
        for scene_id in (LIVING, STUDY)
    }
    monkeypatch.setitem(sys.modules, "habitat_sim", stand_in)
    monkeypatch.setattr(stand_in.Simulator, "SCENES", scenes)
    monkeypatch.setattr(stand_in.Simulator, "opened", 0)
    dataset = tmp_path / "demo.scene_dataset_config.json"
    dataset.write_text("{}")
    return HabitatSimulator(dataset, CONFIG)


@given(st.floats(-math.pi, math.pi, exclude_min=True))
def test_headings_are_the_same_there_and_back(yaw: float) -> None:
    assert math.remainder(yaw_from(rotation_of(yaw)) - yaw, 2 * math.pi) == pytest.approx(0, abs=1e-12)
    assert rotation_of(yaw) == pytest.approx(rotation(yaw), abs=1e-6)  # as exported episodes have it
    x, y, z, w = rotation_of(yaw)
    psi = 2 * math.atan2(y, w)
    assert (-math.sin(psi), math.cos(psi)) == pytest.approx((math.cos(yaw), math.sin(yaw)), abs=1e-9)  # -Z forward, turned about +Y
    assert (x, z) == pytest.approx((0, 0))


@pytest.mark.parametrize("scene_id", [LIVING, STUDY])
def test_it_goes_as_our_own_simulator_goes(simulator: HabitatSimulator, scene_id: str) -> None:
    made = acted_scene(scene_id)
    world = World(scene_id, path_finder(made.navmesh, "a.navmesh"), StandInCamera(), ["0001"], made.episodes, CONFIG.reach_m)
    ours, rng = WorldSimulator(lambda _: world, CONFIG), np.random.default_rng(0)
    for episode in made.episodes:
        states = simulator.reset(episode), ours.reset(episode)
        for action in rng.choice([1, 1, 2, 3], 40):
            theirs, own = states
            assert (theirs.x, theirs.y) == pytest.approx((own.x, own.y), abs=1e-3)  # at grazing walls single precision counts
            assert math.remainder(theirs.yaw - own.yaw, 2 * math.pi) == pytest.approx(0, abs=1e-5)
            assert theirs.collided == own.collided
            assert simulator.geodesic(view_points(episode)) == pytest.approx(ours.geodesic(view_points(episode)), abs=2e-3)
            states = simulator.step(int(action)), ours.step(int(action))
        assert simulator.step(0).called_stop
        assert simulator.snap((0.0, 0.0)) == pytest.approx(ours.snap((0.0, 0.0)), abs=1e-6)


def test_it_shows_what_our_own_shows(simulator: HabitatSimulator) -> None:
    simulator.reset(acted_scene(STUDY).episodes[0])
    sight = simulator.render()
    assert (sight.rgb.shape, sight.rgb.dtype) == ((6, 8, 3), np.uint8)
    assert (sight.depth.shape, sight.depth.dtype) == ((6, 8), np.float32)
    assert sight.semantic.dtype == np.int32
    assert sight.semantic[0].tolist() == [2, 0, NO_OBJECT, *[NO_OBJECT] * 5]  # instances by number, not classes


def test_one_scene_is_open_at_a_time(simulator: HabitatSimulator) -> None:
    first, second = acted_scene(STUDY).episodes[:2]
    simulator.reset(first)
    simulator.reset(second)
    simulator.reset(acted_scene(LIVING).episodes[0])
    assert stand_in.Simulator.opened == 1
    simulator.close()
    simulator.close()
    assert stand_in.Simulator.opened == 0


def test_what_is_not_there_is_named(simulator: HabitatSimulator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stand_in.Simulator, "SCENES", {})
    with pytest.raises(InputError, match="habitat-sim finds no such scene, or no navmesh of it; export the dataset again"):
        simulator.reset(acted_scene(STUDY).episodes[0])
    assert stand_in.Simulator.opened == 0
    with pytest.raises(ValueError, match="action: must be 0 to 3, is 4"):
        simulator.step(4)
    with pytest.raises(InputError, match="dataset: there is no such file"):
        HabitatSimulator(tmp_path / "none.json", CONFIG)
    monkeypatch.setitem(sys.modules, "habitat_sim", None)
    with pytest.raises(InputError, match=r"habitat_sim: simulator: habitat needs this package: .*; install habitat-sim, or act in"):
        HabitatSimulator(tmp_path / "none.json", CONFIG)
