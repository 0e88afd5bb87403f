"""Environments of gymnasium on a lake: its own checker, a batch against single ones, seeds, other people's learning, errors for people."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from flows.simulation.environment import ObjectNavEnv
from flows.simulation.registration import ENVIRONMENT, register
from flows.simulation.scenes import _SHARED
from flows.simulation.vector import ObjectNavVectorEnv
from schemas.errors import InputError
from tasks.simulation.protocol import ACTIONS
from tests.conftest import REPOSITORY
from tests.tasks.simulation.acted_scenes import CONFIG, LIVING, STUDY, acted_lake, acted_scene
from warehouse.lake import Lake

SMALL = {"width": 12, "height": 8}
KEYS = {"rgb", "depth", "semantic", "objectgoal", "compass", "gps"}


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> str:
    return acted_lake(tmp_path_factory.mktemp("acted") / "lake").address


def same(one: Any, other: Any) -> None:
    """Both are the same to the last bit, types included."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            same(one[name], other[name])
    elif isinstance(one, tuple):
        for mine, others in zip(one, other, strict=True):
            same(mine, others)
    elif isinstance(one, np.ndarray):
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
        if one.dtype == object:
            same(tuple(one), tuple(other))
        else:
            assert np.array_equal(one, other)
    else:
        assert one == other


def actions(seed: int, count: int, agents: int) -> Iterator[np.ndarray]:
    return iter(np.random.default_rng(seed).choice(4, (count, agents), p=(0.1, 0.5, 0.2, 0.2)))


@pytest.mark.whole
def test_gymnasium_knows_it_once_the_package_is_imported(lake: str) -> None:
    code = (
        f"import gymnasium; env = gymnasium.make('flows.simulation:metascenes/ObjectNav-v0', lake='{lake}'); print(env.spec.id); "
        f"print(type(gymnasium.make_vec('metascenes/ObjectNav-v0', num_envs=2, lake='{lake}', max_episode_steps=5)).__name__)"
    )  # fmt: skip
    done = subprocess.run([sys.executable, "-W", "error::UserWarning", "-c", code], capture_output=True, text=True, cwd=REPOSITORY)
    assert (done.returncode, done.stdout.split()) == (0, [ENVIRONMENT, "ObjectNavVectorEnv"]), done.stderr


def test_who_imports_it_twice_does_no_harm() -> None:
    before = gymnasium.registry[ENVIRONMENT]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        register()
    assert gymnasium.registry[ENVIRONMENT] is before


def test_gymnasiums_checker_has_nothing_to_say(lake: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(ENVIRONMENT, lake=lake, **SMALL).unwrapped)


def test_spaces_are_named_and_typed_as_habitats(lake: str) -> None:
    env = ObjectNavEnv(lake, width=12, height=8)
    spaces = {name: (space.shape, str(space.dtype)) for name, space in env.observation_space.items()}
    assert spaces == {
        "rgb": ((8, 12, 3), "uint8"), "depth": ((8, 12, 1), "float32"), "semantic": ((8, 12, 1), "int32"), "objectgoal": ((1,), "int64"),
        "compass": ((1,), "float32"), "gps": ((2,), "float32"),
    }  # fmt: skip
    assert env.action_space == gymnasium.spaces.Discrete(4)
    seen, info = env.reset(seed=0)
    assert seen["objectgoal"].tolist() == [env.episodes.categories.index(info["object_category"])]
    assert (seen["compass"].tolist(), seen["gps"].tolist()) == ([0.0], [0.0, 0.0])
    assert 0 < seen["depth"].max() <= 1


def test_the_expert_of_every_episode_wins_it(lake: str) -> None:
    env = ObjectNavEnv(lake, split=None, success_m=CONFIG.success_m, **SMALL)
    assert {scene for scene, _ in env.episodes.names} == {LIVING, STUDY}
    for scene_id, episode_id in env.episodes.names:
        (episode,) = (e for e in acted_scene(scene_id).episodes if e.episode_id == episode_id)
        _, first = env.reset(options={"scene_id": scene_id, "episode_id": episode_id})
        assert (first["scene_id"], first["episode_id"], first["instance_id"]) == (scene_id, episode_id, episode.instance_id)
        assert first["distance_to_goal"] == pytest.approx(episode.geodesic_m, abs=1e-3)
        rewards = []
        for action in episode.actions:
            _, reward, ended, cut, info = env.step(np.int64(ACTIONS.index(action)))
            rewards.append(reward)
            assert not cut
        assert ended
        assert (info["success"], info["num_steps"], info["collisions"]) == (1.0, len(episode.actions), 0)
        assert info["distance_to_goal"] < CONFIG.success_m
        assert info["spl"] >= 1 / CONFIG.max_path_ratio
        expected = first["distance_to_goal"] - info["distance_to_goal"] - 0.01 * len(rewards) + 2.5
        assert sum(rewards) == pytest.approx(expected, abs=1e-9)


def test_an_episode_is_cut_after_so_many_steps(lake: str) -> None:
    env = ObjectNavEnv(lake, max_steps=3, **SMALL)
    env.reset(seed=0)
    assert [env.step(np.int64(2))[2:4] for _ in range(3)] == [(False, False), (False, False), (False, True)]


def test_a_success_can_ask_for_the_target_in_view(lake: str) -> None:
    """The target is in view at a stop where a pixel of the semantic picture has its number."""
    wins = set()
    for must_see in (False, True):
        env = ObjectNavEnv(lake, split=None, success_m=1.0, must_see=must_see, width=32, height=32)
        for scene_id, episode_id in env.episodes.names:
            for turns in (0, 6):  # the expert ends with its target ahead or not; half a turn later it is the other way round
                env.reset(options={"scene_id": scene_id, "episode_id": episode_id})
                (episode,) = (e for e in acted_scene(scene_id).episodes if e.episode_id == episode_id)
                for action in (*episode.actions[:-1], *["left"] * turns):
                    env.step(np.int64(ACTIONS.index(action)))
                seen, *_, info = env.step(np.int64(0))
                is_seen = bool((seen["semantic"] == int(episode.instance_id)).any())
                assert info["success"] == float(is_seen or not must_see)
                wins.add((must_see, is_seen))
    assert len(wins) == 4


def test_the_same_seed_gives_the_same_episodes_and_pictures(lake: str) -> None:
    one, other = (gymnasium.make(ENVIRONMENT, lake=lake, split=None, **SMALL) for _ in range(2))
    drawn = set()
    for seed in (3, 3, None, None, 4):
        mine, others = one.reset(seed=seed), other.reset(seed=seed)
        same(mine, others)
        drawn.add((mine[1]["scene_id"], mine[1]["episode_id"]))
        for (action,) in actions(0, 5, 1):
            step = one.step(action)
            same(step, other.step(action))
            if step[2]:
                break
    assert len(drawn) > 1


@pytest.mark.parametrize("copy", [True, False])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_batch_is_as_many_single_ones(lake: str, mode: AutoresetMode, copy: bool) -> None:
    values = {"lake": lake, "split": None, "max_steps": 7, **SMALL}
    batch = gymnasium.make_vec(ENVIRONMENT, num_envs=5, autoreset_mode=mode.value, copy=copy, **values)
    single = gymnasium.make_vec(ENVIRONMENT, num_envs=5, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **values)
    assert isinstance(batch, ObjectNavVectorEnv)
    assert batch.metadata["autoreset_mode"] is mode
    assert (batch.observation_space, batch.action_space) == (single.observation_space, single.action_space)
    same(batch.reset(seed=3), single.reset(seed=3))
    endings = 0
    for action in actions(1, 40, 5):
        step = batch.step(action)
        same(step, single.step(action))
        assert batch.observation_space.contains(step[0])
        over = step[2] | step[3]
        endings += int(over.sum())
        if mode is AutoresetMode.DISABLED and over.any():
            with pytest.raises(ValueError, match="has ended its episode"):
                batch.step(action)
            same(batch.reset(options={"reset_mask": over}), single.reset(options={"reset_mask": over}))
    assert endings > 5


def test_seeds_of_a_batch_are_one_each(lake: str) -> None:
    batch = ObjectNavVectorEnv(3, lake, split=None, **SMALL)
    in_a_row = batch.reset(seed=5)
    same(in_a_row, batch.reset(seed=[5, 6, 7]))
    alone = ObjectNavEnv(lake, split=None, **SMALL).reset(seed=6)[0]
    assert all(np.array_equal(in_a_row[0][name][1], alone[name]) for name in KEYS)


def test_pictures_are_shown_where_they_are_asked_for(lake: str) -> None:
    env = gymnasium.make(ENVIRONMENT, lake=lake, render_mode="rgb_array", **SMALL)
    seen, _ = env.reset(seed=0)
    assert np.array_equal(env.render(), seen["rgb"])
    batch = gymnasium.make_vec(ENVIRONMENT, num_envs=2, lake=lake, render_mode="rgb_array", **SMALL)
    seen, _ = batch.reset(seed=0)
    assert np.array_equal(np.stack(batch.render()), seen["rgb"])
    assert ObjectNavEnv(lake, **SMALL).render() is None


def test_environments_of_a_process_share_their_scenes(lake: str) -> None:
    before = len(_SHARED)
    envs = [ObjectNavEnv(lake, width=8 + i, height=8) for i in range(3)] + [ObjectNavEnv(lake, STUDY, split="test", **SMALL)]
    for env in envs:
        env.reset(seed=0)
    assert len(_SHARED) <= before + 1
    assert envs[0].episodes.world(LIVING) is envs[2].episodes.world(LIVING)
    assert {category for env in envs for category in env.episodes.categories} == set(envs[3].episodes.categories)


def test_categories_can_be_those_of_another_lake(lake: str) -> None:
    named = ("zebra", "desk", "chair", "shelf")
    env = ObjectNavEnv(lake, STUDY, "test", categories=named, **SMALL)
    seen, info = env.reset(seed=0)
    assert named[int(seen["objectgoal"][0])] == info["object_category"]
    assert env.observation_space["objectgoal"].high.tolist() == [3]


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"scenes": ("demo/living_01",)}, r"scenes: there is no demo/living_01; did you mean demo/living_00\?"),
        ({"scenes": STUDY}, "split: no episode of these scenes is of train; they are of test"),
        ({"split": "valid"}, "split: there is no 'valid'; it is train or test, or None for both"),
        ({"agent": "giant"}, "agent: there is no 'giant'; name one of cylinder_r18_h88"),
        ({"categories": ("zebra",)}, "categories: 'chair' is a target and not among them; name all of chair, desk"),
        ({"snapshot": 77}, "snapshot: there is no snapshot 77"),
        ({"release": "v1"}, "release: no release 'v1'"),
        ({"widht": 8}, r"metascenes/ObjectNav-v0: widht: there is no such setting; did you mean width\?"),
        ({"width": 0}, "metascenes/ObjectNav-v0: width: must be at least 1, is 0"),
        ({"render_mode": "human"}, "render_mode: there is no 'human'; it is rgb_array, or None"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(lake: str, values: dict[str, Any], problem: str) -> None:
    for make in (ObjectNavEnv, lambda **given: ObjectNavVectorEnv(2, **given)):
        with pytest.raises(InputError, match=problem):
            make(lake=lake, **values)


def test_what_a_batch_cannot_be_is_refused(lake: str) -> None:
    with pytest.raises(InputError, match="num_envs: must be at least 1, is 0"):
        ObjectNavVectorEnv(0, lake)
    with pytest.raises(InputError, match="autoreset_mode: there is no 'Never'; it is one of NextStep, SameStep, Disabled"):
        ObjectNavVectorEnv(1, lake, autoreset_mode="Never")
    batch = ObjectNavVectorEnv(2, lake, **SMALL)
    with pytest.raises(ValueError, match="reset: must come first"):
        batch.step(np.array([1, 1]))
    with pytest.raises(InputError, match="seed: there are 3, and 2 agents"):
        batch.reset(seed=[1, 2, 3])
    with pytest.raises(InputError, match="reset_mask: leaves out agents that have no episode yet"):
        batch.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(InputError, match="reset_mask: must be 2 truths"):
        batch.reset(options={"reset_mask": np.array([True])})


def test_episodes_that_are_not_there_are_refused(lake: str) -> None:
    env = ObjectNavEnv(lake, **SMALL)
    with pytest.raises(ValueError, match="reset: must come first"):
        env.step(np.int64(1))
    with pytest.raises(InputError, match="demo/living_00 episode 9999: there is no such episode; it has 6"):
        env.reset(options={"scene_id": LIVING, "episode_id": "9999"})
    with pytest.raises(InputError, match="options: are episode_id; give scene_id and episode_id, or none"):
        env.reset(options={"episode_id": "0000"})


def test_a_lake_without_episodes_or_none_at_all_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="lake: there is no lake; name its folder"):
        ObjectNavEnv(tmp_path / "none")
    made = acted_lake(tmp_path / "lake", (STUDY,))
    made.remove_scene(STUDY)
    with pytest.raises(InputError, match="episodes: the lake has none; `metascenes run` makes them"):
        ObjectNavEnv(Lake.open(tmp_path / "lake").address)


@pytest.mark.whole
def test_stable_baselines_learns_from_it(lake: str) -> None:
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_checker import check_env as check_for_baselines
    from stable_baselines3.common.env_util import make_vec_env

    check_for_baselines(ObjectNavEnv(lake, width=36, height=36), warn=False)
    env = make_vec_env(ENVIRONMENT, n_envs=2, seed=0, env_kwargs={"lake": lake, "width": 36, "height": 36, "max_steps": 20})
    model = PPO("MultiInputPolicy", env, n_steps=16, batch_size=16, n_epochs=1, seed=0, device="cpu")
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(64)
    assert model.num_timesteps == 64
    assert any((old != new).any() for old, new in zip(before, model.policy.parameters(), strict=True))
    action, _ = model.predict(env.reset(), deterministic=True)
    assert env.action_space.contains(action[0])
