"""Trained policies in the episodes of a lake: which model acts, what is measured once, and what a kill leaves."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from flows.commands.evaluate import command
from flows.evaluation import acting
from flows.inputs import policies
from flows.inputs.evaluation import run_policy
from flows.inputs.policies import trained_policy
from flows.run.configuration import configure
from flows.training.folders import withdraw_model
from flows.training.training import planned_training, system_configuration
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.runs import StageRun
from schemas.training import LearnedModel
from tasks.evaluation.configuration import EvaluationConfig
from tasks.models import identity_json, model_id_of
from tasks.policy.inference.actor import load
from tasks.policy.rollout import rolled_out
from tasks.training.systems.navigation import NAVIGATION, NavigationTraining
from tests.samples import fingerprint, stage_run
from tests.tasks.policy.policies import TINY, drawn_weights
from tests.tasks.simulation.acted_scenes import LIVING, STUDY, acted_lake, acted_scene
from warehouse.lake import Lake
from warehouse.tables.digest import digests

pytestmark = pytest.mark.whole

SHORT = configure(settings=["evaluation.max_steps=20"])


def keep_model(lake: Lake, seed: int = 0, at: float = 1.0) -> LearnedModel:
    """A policy with random weights, as if it had been trained in the lake."""
    weights, text = drawn_weights(TINY, seed=seed), identity_json(NavigationTraining(model=TINY))
    row = LearnedModel(
        model_id=model_id_of(weights, text), training_id=f"navigation-{seed}", kind="navigation", origin="trained", architecture="small",
        parameter_count=3, config=text, weights_blob=lake.blobs.put(weights, "weights"), weights_bytes=len(weights), dataset="snapshot 1",
        snapshot_id=1, release=None, dataset_fingerprint="a" * 64, examples=("train=5",), seed=seed, code_fingerprint="b" * 64,
        device="cpu", seconds=2.5, license="CC0-1.0", parent_id=None, is_fallback=True, is_withdrawn=False, notes=("made up",),
    )  # fmt: skip
    lake.stage_rows(stage_run(row.training_id, "training", fingerprint(row.training_id), at=at), {"models": [row]})
    lake.commit("a policy")
    return row


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return acted_lake(tmp_path / "lake")


def test_runs_with_and_without_the_reflex_are_two(lake: Lake) -> None:
    row = keep_model(lake)
    names = [
        run_policy(lake, row.model_id, configure(settings=["evaluation.max_steps=20", f"evaluation.turns_aside={aside}"])).run_name
        for aside in ("true", "false")
    ]
    assert names == [row.model_id[:12], f"{row.model_id[:12]}, without turning aside"]
    with lake.snapshot().connect() as connection:
        counted = connection.sql("SELECT run_name, sum(n) FROM navigation_metrics GROUP BY run_name ORDER BY run_name").fetchall()
    assert counted == [(name, 12) for name in names]


def test_a_training_does_not_go_on_from_a_policy_that_senses_something_else(lake: Lake) -> None:
    row = keep_model(lake)
    seeing = system_configuration("navigation", None, ["training.system.model.eyes.depth=true"], None)
    with pytest.raises(InputError, match=f"model {row.model_id[:12]}: senses_depth: is false of it, and true of what is to be trained"):
        planned_training(lake, seeing, start=row.model_id)
    plain = system_configuration("navigation", None, [], None)
    assert planned_training(lake, plain, start=row.model_id).training_id != planned_training(lake, plain).training_id


def test_a_model_acts_in_every_scene_and_is_measured_once(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    row = keep_model(lake)
    done = run_policy(lake, row.model_id[:8], SHORT)
    assert (done.policy, done.run_name, done.scenes, done.new, done.failed) == ("navigation", row.model_id[:12], 2, 12, ())
    rows = lake.snapshot().rows(Trajectory)
    actor, config = load(drawn_weights(TINY), TINY), EvaluationConfig(max_steps=20)
    for scene in (LIVING, STUDY):
        world = policies.Worlds(lake, lake.snapshot(), "cylinder_r18_h88", config.reach_m).world(scene)
        expected = rolled_out(world, actor, sorted(acted_scene(scene).episodes, key=lambda e: e.episode_id), config)
        mine = [each for each in rows if each.scene_id == scene]
        assert [each.actions for each in mine] == [attempt.actions for attempt in expected]
        assert all(each.is_target_seen is not None for each in mine)
        assert all(each.called_stop == (each.actions[-1] == "stop") and len(each.actions) <= 20 for each in mine)

    def never(*_: object, **__: object) -> None:
        raise AssertionError("what is measured is not acted again")

    monkeypatch.setattr(policies, "rolled_out", never)
    assert run_policy(lake, "navigation", SHORT) == dataclasses.replace(done, new=0)
    with lake.snapshot().connect() as connection:
        shares = connection.sql("SELECT sr, found_share, looked_at, n FROM navigation_metrics WHERE policy = 'navigation'").fetchall()
    assert sum(n for *_, n in shares) == sum(looked for _, _, looked, _ in shares) == 12


def test_who_was_killed_goes_on_and_comes_to_the_same_rows(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row, other = keep_model(lake), acted_lake(tmp_path / "other")
    keep_model(other)
    run_policy(other, row.model_id, SHORT)
    execute, seen = acting.execute, list[str]()

    def killed(job: object, *words: object, **options: object) -> object:
        if seen:
            raise KeyboardInterrupt
        seen.append("once")
        return execute(job, *words, **options)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        patched.setattr(acting, "execute", killed)
        with pytest.raises(KeyboardInterrupt):
            run_policy(lake, row.model_id, SHORT)
    assert lake.snapshot().rows(Trajectory) == []
    assert run_policy(lake, row.model_id, SHORT).new == 6, "the first scene was staged before"
    assert digests(lake.snapshot())["trajectories"] == digests(other.snapshot())["trajectories"]


def test_the_newest_policy_that_was_not_withdrawn_acts(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    [(name, shipped)] = NAVIGATION.shipped().items()
    assert trained_policy(lake, "navigation").model_id == trained_policy(lake, name).model_id == shipped.model.model_id
    with monkeypatch.context() as patched:
        patched.setattr(policies, "listed_models", lambda reader: [])
        with pytest.raises(InputError, match="no policy was trained in this lake, and none ships"):
            trained_policy(lake, "navigation")
    first, second = keep_model(lake, 0, 1.0), keep_model(lake, 1, 2.0)
    assert trained_policy(lake, "navigation").model_id == second.model_id
    assert trained_policy(lake, first.model_id[:10]).model_id == first.model_id
    withdraw_model(lake, second.model_id, "walks into walls")
    assert trained_policy(lake, "navigation").model_id == first.model_id
    with pytest.raises(InputError, match="was withdrawn"):
        trained_policy(lake, second.model_id)
    with pytest.raises(InputError, match="is no policy"):
        trained_policy(lake, "exprt")


@pytest.mark.slow
def test_the_command_names_models_and_says_who_found_what(lake: Lake) -> None:
    row, runner = keep_model(lake), CliRunner()
    words = ["--policy", row.model_id[:8], "--policy", "expert", "--lake", lake.address]
    done = runner.invoke(command, [*words, "--json"], catch_exceptions=False)
    told = json.loads(done.output)
    assert {each["policy"]: each["new"] for each in told["policies"]} == {"navigation": 12, "expert": 12}
    assert {each["policy"] for each in told["metrics"]} == {"navigation", "expert"}
    lines = runner.invoke(command, words, catch_exceptions=False).output
    assert "at 1 m in view" in lines
    assert "12 trajectories in 2 scenes: 0 measured, 12 are in the lake already" in lines
    assert {each["run_name"] for each in told["policies"]} == {row.model_id[:12], "built-in"}
    refused = runner.invoke(command, ["--policy", "random", "--policy", "exprt", "--lake", lake.address])
    assert isinstance(refused.exception, InputError)
    assert {each.policy for each in lake.snapshot().rows(Trajectory)} == {"navigation", "expert"}, (
        "nobody acted before all names were known"
    )


def test_a_scene_in_which_it_cannot_act_stops_no_other(lake: Lake) -> None:
    row = keep_model(lake)
    mesh = acted_scene(STUDY).rows["navmeshes"][0].navmesh_blob
    (Path(lake.address) / "blobs" / mesh[:2] / mesh[2:4] / mesh).unlink()
    done = run_policy(Lake.open(lake.address), row.model_id, SHORT)
    assert (done.scenes, done.new) == (1, 6)
    assert [line.partition(": ")[0] for line in done.failed] == [STUDY]
    assert "is not in the lake; run the navigation stage again" in done.failed[0]
    failed = [run for run in lake.snapshot().rows(StageRun) if run.stage == "evaluation" and run.outcome == "failed"]
    assert len(failed) == 1
