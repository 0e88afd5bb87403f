"""What is compared: choices of datasets, test episodes, and rooms that must not be on both sides."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from flows.commands.training.compare import command
from flows.comparison.planning import asked_comparison, planned_comparison, room_name
from flows.evaluation import acting
from flows.run.configuration import Configuration
from flows.run.fingerprints import code_fingerprint
from flows.training.datasets import chosen_dataset
from flows.training.models import reads_of
from flows.training.training import planned_training, system_configuration
from schemas.capture import Instance, Scene, Shell
from schemas.errors import InputError
from schemas.navigation import Episode, Navmesh, Split, UnreachableTarget
from schemas.record import table_of
from tasks.navigation import split_of
from tests.flows.comparison.lakes import QUICK, SCENES, compared_lake
from tests.samples import fingerprint, stage_run
from tests.tasks.simulation.acted_scenes import LIVING, acted_scene, as_scene, lake_of_scenes
from warehouse.lake import Lake

pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return compared_lake(tmp_path_factory.mktemp("compared") / "lake")


def told(*settings: str) -> Configuration:
    return system_configuration("navigation", settings=settings)


def planned(lake: Lake, train: list[str], test: list[str], *settings: str) -> Any:
    return planned_comparison(lake, asked_comparison(train, test), told(*settings))


@pytest.mark.parametrize(
    ("train", "test", "problem"),
    [
        (["a"], ["c"], "--train: a: is nothing to compare; give --train at least twice"),
        (["a", "b", " b+b"], ["c"], "--train: b: is named twice"),
        (["a+b", "b + a"], ["c"], "--train: a+b: is named twice"),
        (["a", "b+"], ["c"], "--train: b+: names no dataset on one side of +"),
        (["a", "b"], [], "--test: names no dataset"),
    ],
)
def test_what_is_no_comparison_is_refused(train: list[str], test: list[str], problem: str) -> None:
    with pytest.raises(InputError) as refused:
        asked_comparison(train, test)
    assert str(refused.value).startswith(problem)


@pytest.mark.parametrize("room", ["alpha/scene0012_03", "beta/scene0012", "gamma/kitchen", "kitchen_01", "x/scene12_00"])
def test_rooms_of_one_name_are_on_one_side(room: str) -> None:
    for share in (0.2, 0.5, 0.8):
        assert split_of(room, share) == split_of(f"elsewhere/{room_name(room)}", share)
    assert room_name("a/scene0012_03") == room_name("b/scene0012_00") == "scene0012"


def test_rooms_that_are_learned_from_are_left_out_of_the_test_whatever_dataset_they_are_in(lake: Lake) -> None:
    whole = planned(lake, ["alpha", "beta", "alpha+beta"], ["gamma"])
    assert set(whole.episodes) == {"gamma/one", "gamma/two"}, "gamma/leak is room_a, which alpha has too"
    assert whole.notes[0] == "gamma: 1 of 3 scenes is left out, their rooms are learned from"
    assert "gamma: 2 scenes to test in, not 10" in whole.notes
    assert [(each.trained_on, each.seed) for each in whole.trainings] == [
        (label, seed) for label in ("alpha", "beta", "alpha+beta") for seed in (0, 1, 2)
    ]
    assert len({each.planned.training_id for each in whole.trainings}) == 9
    assert set(planned(lake, ["beta", "gamma"], ["alpha"]).episodes) == {"alpha/two"}
    own = planned(lake, ["alpha", "beta"], ["beta"])
    assert set(own.episodes) == {"beta/kept"}, "of a dataset that is learned from its test rooms are left"
    with pytest.raises(InputError, match=r"^--test: alpha: is trained on: all of its 2 scenes with episodes are in rooms that a policy"):
        planned(lake, ["alpha", "beta"], ["alpha"])


def test_more_scenes_and_episodes_come_on_top_of_fewer(lake: Lake) -> None:
    one = planned(lake, ["alpha", "beta"], ["gamma"], "comparison.scenes=1", "comparison.trajectories=2")
    two = planned(lake, ["alpha", "beta"], ["gamma"], "comparison.scenes=2", "comparison.trajectories=5")
    ((scene, names),) = one.episodes.items()
    assert len(names) == 2
    assert two.episodes[scene][:2] == names
    assert [len(each) for each in two.episodes.values()] == [5, 5]
    assert one.comparison_id != two.comparison_id
    assert [each.planned.training_id for each in one.trainings] == [each.planned.training_id for each in two.trainings]


def test_what_is_in_test_scenes_and_the_code_that_acts_name_the_comparison(
    lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = Lake.open(shutil.copytree(lake.address, tmp_path / "lake"))

    def name() -> str:
        whole = planned(copy, ["alpha", "beta"], ["gamma"], "comparison.seeds=1", "comparison.scenes=1")
        assert len(whole.episodes) == 1
        assert [each.planned.training_id for each in whole.trainings] == trainings
        return str(whole.comparison_id)

    before = planned(copy, ["alpha", "beta"], ["gamma"], "comparison.seeds=1", "comparison.scenes=1")
    trainings, (scene,) = [each.planned.training_id for each in before.trainings], before.episodes
    (elsewhere,) = {"gamma/one", "gamma/two"} - {scene}

    def changed(scene_id: str) -> None:
        """The scene's episodes begin with another look."""
        rows = {table_of(record).name: copy.snapshot().rows(record, scene_id) for record in (Navmesh, UnreachableTarget)}
        rows["splits"] = [row for row in copy.snapshot().rows(Split) if row.room_id == SCENES[scene_id][1]]
        episodes = copy.snapshot().rows(Episode, scene_id)
        turned = [dataclasses.replace(row, start_yaw_radians=row.start_yaw_radians + 0.25) for row in episodes]
        above = f"optimization={fingerprint(scene_id, 'optimization')}"
        copy.stage_rows(stage_run(scene_id, "navigation", fingerprint(scene_id, "anew"), above), {**rows, "episodes": turned})
        copy.commit("anew")

    assert name() == before.comparison_id
    changed(elsewhere)
    assert name() == before.comparison_id, "nobody is tested there"
    changed(scene)
    turned = name()
    assert turned != before.comparison_id, "the same names of episodes, and other starts"
    for module in ("tasks.policy.rollout", "tasks.evaluation"):
        with monkeypatch.context() as patched:
            patched.setattr(
                acting, "code_fingerprint", lambda given, module=module: "0" * 64 if given == module else code_fingerprint(given)
            )
            assert name() != turned, module


def test_every_dataset_of_a_choice_has_something_to_learn_from(tmp_path: Path) -> None:
    rooms = {"alpha/one": "alpha/room_a", "kept/one": "kept/room_c", "gamma/one": "gamma/room_x"}
    small = lake_of_scenes(tmp_path / "lake", {name: as_scene(acted_scene(LIVING), name, room) for name, room in rooms.items()})
    assert planned(small, ["alpha", "gamma"], ["kept"]).episodes.keys() == {"kept/one"}
    for choice in ("kept", "alpha+kept"):  # trained on both the policy would be that of alpha alone, to the last bit
        with pytest.raises(InputError) as refused:
            planned(small, ["alpha", choice], ["gamma"])
        assert str(refused.value).startswith(f"--train: {choice}: kept adds nothing to learn from, it has no episode in a room of the")


@pytest.mark.parametrize(
    ("train", "test", "problem"),
    [
        (["alpha", "betta"], ["gamma"], "--train: betta: is no dataset of the lake; did you mean beta? the lake has alpha, beta, gamma"),
        (["alpha", "beta"], ["delta"], "--test: delta: is no dataset of the lake"),
    ],
)
def test_datasets_that_the_lake_does_not_have_are_refused(lake: Lake, train: list[str], test: list[str], problem: str) -> None:
    with pytest.raises(InputError) as refused:
        planned(lake, train, test)
    assert str(refused.value).startswith(problem)
    with pytest.raises(InputError, match=r"training\.datasets: delta: is no dataset of the lake"):
        planned_training(lake, told("training.datasets=['delta']"))
    with pytest.raises(InputError, match="and --train says what is learned from"):
        planned(lake, ["alpha", "beta"], ["gamma"], "training.datasets=['alpha']")


def test_a_dataset_is_its_scenes_and_a_training_is_named_by_their_content(lake: Lake, tmp_path: Path) -> None:
    alpha = chosen_dataset(lake, datasets=["alpha"])
    assert alpha.name == f"snapshot {lake.snapshot().snapshot_id}: alpha"
    for record in (Scene, Shell, Instance, Episode):
        assert {row.scene_id for row in alpha.rows(record)} == {"alpha/one", "alpha/two"}
    reads = reads_of("navigation")
    every, named = (chosen_dataset(lake, datasets=names).fingerprint(reads) for names in ((), ("gamma", "beta", "alpha")))
    assert every == named, "all that there is has one name"
    assert len({every, *(chosen_dataset(lake, datasets=[name]).fingerprint(reads) for name in ("alpha", "beta", "gamma"))}) == 4
    assert len({planned_training(lake, told(*settings)).training_id for settings in
                ([], ["training.datasets=['alpha']"], ["training.datasets=['beta', 'alpha']"])}) == 3  # fmt: skip


def test_the_command_says_what_would_be_done_and_writes_nothing(lake: Lake, tmp_path: Path) -> None:
    (tmp_path / "quick.toml").write_text(QUICK)
    words = ["navigation", "--train", "alpha", "--train", "beta", "--test", "gamma", "--config", str(tmp_path / "quick.toml")]
    before = lake.snapshot().snapshot_id
    done = CliRunner().invoke(command, [*words, "--lake", lake.address, "--seeds", "2", "--dry-run", "--json"], catch_exceptions=False)
    plan = json.loads(done.stdout)
    assert (plan["to_train"], plan["to_measure"]) == (4, 4 * 2 * 4)
    assert {each["state"] for each in plan["trainings"]} == {"never done"}
    assert {scene: len(names) for scene, names in plan["episodes"].items()} == {"gamma/one": 4, "gamma/two": 4}
    lines = CliRunner().invoke(command, [*words, "--lake", lake.address, "--steps", "7", "--dry-run"], catch_exceptions=False).output
    assert "2 models would be trained, 16 trajectories measured" in lines
    assert plan["comparison_id"] not in lines, "another budget is another comparison"
    assert lake.snapshot().snapshot_id == before
    assert set(SCENES) == {row.scene_id for row in lake.snapshot().rows(Scene)}
