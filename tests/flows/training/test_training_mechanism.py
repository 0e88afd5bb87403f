"""A made-up learned system through the whole mechanism, in interpreters that have it: trained, killed, kept, handed on and used again."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bench.samples import stage_whole_scene
from schemas.training import LearnedModel, ModelEvaluation, TrainingStep
from tests.conftest import REPOSITORY
from warehouse.lake import Lake
from warehouse.questions.sql import query
from warehouse.release import make_release
from warehouse.upkeep.erasure import erase
from warehouse.upkeep.inspection import inspect
from warehouse.upkeep.vacuum import vacuum

pytest.importorskip("torch")
pytestmark = pytest.mark.whole

Told = Callable[..., subprocess.CompletedProcess[str]]
SCENES = 6


@pytest.fixture(scope="module")
def made_lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    lake = Lake.open(tmp_path_factory.mktemp("made") / "lake")
    for index in range(SCENES):
        stage_whole_scene(lake, f"scannet/scene{index:04d}_00", 0, index)
    lake.commit("scenes")
    return Path(lake.address)


@pytest.fixture
def lake(made_lake: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made_lake, tmp_path / "lake"))


@pytest.fixture(scope="module")
def learned_lake(made_lake: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The lake with a model, and what its training said."""
    folder = tmp_path_factory.mktemp("learned")
    lake = Path(shutil.copytree(made_lake, folder / "lake"))
    return lake, trained(command_in(folder), lake)


@pytest.fixture
def learned(learned_lake: tuple[Path, dict[str, Any]], tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    return Path(shutil.copytree(learned_lake[0], tmp_path / "lake")), learned_lake[1]


@pytest.fixture
def command(tmp_path: Path) -> Told:
    return command_in(tmp_path)


def command_in(folder: Path) -> Told:
    """The command line in an interpreter with the learned system `toy_system`; `code` is its exit code."""

    def call(*words: Any, code: int = 0, cache: str = "cache", **environment: str) -> subprocess.CompletedProcess[str]:
        path = os.pathsep.join([str(REPOSITORY), str(REPOSITORY / "tests" / "made_up")])
        around = {**os.environ, "PYTHONPATH": path, "METASCENES_CACHE": str(folder / cache), **environment}
        done = subprocess.run(
            [sys.executable, "-m", "flows.cli", *map(str, words)], capture_output=True, text=True, env=around, cwd=folder, check=False
        )
        assert done.returncode == code, done.stdout + done.stderr
        return done

    return call


def models(lake: Path) -> list[LearnedModel]:
    return Lake.open(lake).snapshot().rows(LearnedModel)


def trained(command: Told, lake: Path, *words: Any, **given: Any) -> dict[str, Any]:
    row: dict[str, Any] = json.loads(command("train", "toy_system", "--lake", lake, "--json", *words, **given).stdout)
    return row


@pytest.mark.slow
def test_the_same_training_is_one_whoever_loads_batches_and_leaves_all_of_its_rows(command: Told, lake: Path, tmp_path: Path) -> None:
    other = shutil.copytree(lake, tmp_path / "other")
    row = trained(command, lake)
    again = trained(command, lake)
    assert (row["is_new"], again["is_new"]) == (True, False)
    loaded = trained(command, other, "--set", "training.system.fitting.workers=2", cache="of another")
    assert loaded["is_new"]
    assert (loaded["model_id"], loaded["weights_blob"], loaded["training_id"]) == (row["model_id"], row["weights_blob"], row["training_id"])
    reader = Lake.open(lake).snapshot()
    (model,) = models(lake)
    assert (model.kind, model.origin, model.snapshot_id, model.release) == ("toy_system", "trained", 1, None)
    assert model.examples == (f"train={2 * SCENES}",)
    assert [point.step for point in reader.rows(TrainingStep)] == [10, 20, 30, 40, 50, 60]
    measured = {(figure.method, figure.model_id) for figure in reader.rows(ModelEvaluation)}
    assert measured == {("toy_system", model.model_id), ("coin", None)}
    problems = [str(problem) for problem in inspect(Lake.open(lake)).errors]
    known_here = ("blob", "tables/models: kind")  # generated scenes have no blobs, and this process no learned system `toy_system`
    assert [problem for problem in problems if not any(words in problem for words in known_here)] == []
    assert not list((tmp_path / "cache").glob("modules/tasks.training.fitting-*/*.pt")), "checkpoints are gone when all is done"
    assert "nothing to do" in command("train", "toy_system", "--lake", lake, "--dry-run").stdout
    dry = json.loads(command("train", "toy_system", "--lake", lake, "--dry-run", "--json", "--seed", 1).stdout)
    assert dry["state"] == "never done"
    assert dry["training_id"] != model.training_id


@pytest.mark.slow
def test_killed_ten_times_it_ends_with_the_same_weights(command: Told, lake: Path, tmp_path: Path) -> None:
    other = shutil.copytree(lake, tmp_path / "other")
    row = trained(command, lake)
    draws = random.Random(17)
    steps = sorted(draws.randint(1, 60) for _ in range(10))
    for step in steps:  # later and later, as far as a resume may begin before the step of the last kill
        command("train", "toy_system", "--lake", other, code=-signal.SIGKILL, cache="of another", TOY_SYSTEM_KILL_AT=str(step))
        assert not models(other)
    assert trained(command, other, cache="of another")["model_id"] == row["model_id"]
    losses = [[point.loss for point in Lake.open(place).snapshot().rows(TrainingStep)] for place in (lake, other)]
    assert losses[0] == losses[1]


def test_a_killed_training_goes_on_from_its_checkpoint(command: Told, lake: Path, tmp_path: Path) -> None:
    other = shutil.copytree(lake, tmp_path / "other")
    row = trained(command, lake)
    command("train", "toy_system", "--lake", other, code=-signal.SIGKILL, cache="of another", TOY_SYSTEM_KILL_AT="33")
    kept = sorted(path.name[-12:] for path in (tmp_path / "of another").glob("modules/tasks.training.fitting-*/*.pt"))
    assert kept == ["000000021.pt", "000000028.pt"]
    done = command("train", "toy_system", "--lake", other, cache="of another", TOY_SYSTEM_KILL_AT="28")
    assert row["model_id"] in done.stdout, "step 28 is not taken again"


@pytest.mark.slow
def test_one_model_begins_with_another_and_says_so(command: Told, learned: tuple[Path, dict[str, Any]]) -> None:
    lake, first = learned
    second = trained(command, lake, "--from", first["model_id"][:10])
    assert second["parent_id"] == first["model_id"]
    assert second["model_id"] != first["model_id"]
    note = f"test rooms were not compared with the rooms of the model that training began with, which it may know: {first['model_id'][:12]}"
    assert (first["notes"], second["notes"]) == (["made up"], ["made up", note])
    assert f"- {note}" in command("models", "show", second["model_id"], "--lake", lake).stdout
    outline = command("explain", second["model_id"], "--lake", lake).stdout
    assert f"model {first['model_id'][:12]} of toy_system" in outline
    assert "snapshot 2: train=12" in outline
    listed = json.loads(command("models", "list", "--lake", lake, "--json").stdout)["models"]
    assert [row["model_id"] for row in listed if row["origin"] != "shipped"] == [second["model_id"], first["model_id"]], "the newest first"
    refused = command("train", "toy_system", "--lake", lake, "--from", "f" * 12, code=2)
    assert refused.stderr.strip().endswith("there is no model 'ffffffffffff'; `metascenes models list` names them")


@pytest.mark.slow
def test_a_model_goes_to_another_lake_and_back_and_is_withdrawn(
    command: Told, learned: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    lake, row = learned
    out, copied, third = tmp_path / "model", tmp_path / "copied", tmp_path / "third"
    command("models", "export", row["model_id"][:8], "--out", out, "--lake", lake)
    assert sorted(path.name for path in out.iterdir()) == ["README.md", "model.json", "weights.safetensors"]
    assert row["model_id"] in (out / "README.md").read_text()
    command("models", "import", out, "--lake", third)
    command("models", "export", row["model_id"], "--out", copied, "--lake", third)
    assert {path.name: path.read_bytes() for path in copied.iterdir()} == {path.name: path.read_bytes() for path in out.iterdir()}
    assert "in the lake already" in command("models", "import", out, "--lake", lake).stdout
    assert "is there already" in command("models", "export", row["model_id"], "--out", out, "--lake", lake, code=2).stderr
    (imported,) = models(third)
    assert (imported.origin, imported.is_withdrawn, imported.snapshot_id) == ("imported", False, None)
    command("models", "withdraw", row["model_id"], "--reason", "a test", "--lake", third)
    (withdrawn,) = models(third)
    assert (withdrawn.is_withdrawn, withdrawn.notes[-1]) == (True, "withdrawn: a test")
    command("models", "import", out, "--lake", third)
    assert [model.is_withdrawn for model in models(third)] == [False]
    command("models", "withdraw", row["model_id"], "--lake", lake)
    assert "withdrawn, and left so" in command("train", "toy_system", "--lake", lake).stdout
    assert len(Lake.open(lake).snapshot().rows(TrainingStep)) == 6, "what was measured stays"


@pytest.mark.slow
def test_what_is_no_model_is_refused_in_a_line(command: Told, learned: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    lake, row = learned
    whole = tmp_path / "whole"
    command("models", "export", row["model_id"], "--out", whole, "--lake", lake)

    def damaged(name: str, change: Callable[[Path], object]) -> str:
        folder = Path(shutil.copytree(whole, tmp_path / name))
        change(folder)
        said = command("models", "import", folder, "--lake", tmp_path / "new", code=2).stderr.strip()
        assert "\n" not in said
        return said.partition("metascenes: ")[2]

    def changed(**fields: Any) -> Callable[[Path], object]:
        def change(folder: Path) -> object:
            document = json.loads((folder / "model.json").read_text())
            return (folder / "model.json").write_text(json.dumps(document | fields))

        return change

    weights = (whole / "weights.safetensors").read_bytes()
    assert "do not fit" in damaged("short", lambda folder: (folder / "weights.safetensors").write_bytes(weights[:-4]))
    assert "is not that of its weights" in damaged(
        "other seed of weights", lambda f: (f / "weights.safetensors").write_bytes(weights[:-1] + b"?")
    )
    assert "is no JSON" in damaged(
        "pickle", lambda f: (f / "weights.safetensors").write_bytes(len(b"\x80\x04.").to_bytes(8, "little") + b"\x80\x04.")
    )
    assert "cannot be read" in damaged("no weights", lambda folder: (folder / "weights.safetensors").unlink())
    assert "there is no learned system 'other'" in damaged("kind", changed(kind="other"))
    assert "is not that of its weights and config" in damaged("config", changed(config={"kind": "toy_system", "width": 3}))
    assert "format: is 9" in damaged("format", changed(format=9))
    assert "license: is int" in damaged("license", changed(license=3))
    assert "must match" in damaged("parent", changed(parent_id="../x"))
    assert "measures" in damaged("measures", changed(measures=[{"value": 1}]))
    torch_file = tmp_path / "model.pt"
    torch_file.write_bytes(b"\x80\x04")
    refused = command("models", "import", torch_file, "--lake", tmp_path / "new", code=2).stderr
    assert "others could run code" in refused
    assert not Lake.open(tmp_path / "new").exists


@pytest.mark.slow
def test_releases_have_models_and_are_learned_from_and_an_erasure_names_what_learned(
    command: Told, learned: tuple[Path, dict[str, Any]]
) -> None:
    lake, row = learned
    store = Lake.open(lake)
    make_release(store, "v1")
    assert [model["model_id"] for model in query(store.snapshot(), "FROM models").to_pylist()] == [row["model_id"]]
    assert (lake / "releases" / "v1" / "models.parquet").is_file()
    of_release = trained(command, lake, "--release", "v1")
    assert not of_release["is_new"], "the same rows are the same training"
    other = trained(command, lake, "--release", "v1", "--seed", 1)
    assert (other["dataset"], other["release"]) == ("release v1", "v1")
    vacuum(store, days=0)
    assert {model.weights_blob for model in models(lake)} <= set(store.blobs)
    assert set(erase(store, "scannet/scene0003_00", dry_run=True).models) == {row["model_id"], other["model_id"]}
    assert erase(store, "scannet/scene0003_00").models
    assert models(lake), "they stay until somebody withdraws them"
    assert trained(command, lake)["examples"] == [f"train={2 * (SCENES - 1)}"], "other rows are another training"


@pytest.mark.slow
def test_what_cannot_be_trained_says_why_in_a_line(command: Told, lake: Path, tmp_path: Path) -> None:
    for words, said in (
        (("--release", "v9"), "no release 'v9'"),
        (("--snapshot", "9"), "there is no snapshot 9"),
        (("--set", "training.system.fitting.step=3"), "did you mean steps?"),
        (("--set", "training.system.fitting.device=cuda"), "torch sees no CUDA device"),
        (("--set", "training.system.fitting.learning_rate=1e30", "--set", "training.system.fitting.clip_norm=1e30"), "lower learning_rate"),
    ):
        done = command("train", "toy_system", "--lake", lake, *words, code=2)
        assert said in done.stderr.strip().splitlines()[-1]
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "usercustomize.py").write_text(
        "import importlib.util as u; find = u.find_spec; u.find_spec = lambda name, *a: None if name == 'torch' else find(name, *a)\n"
    )
    code = "import sys, usercustomize; from flows.cli import main; main()"
    path = os.pathsep.join([str(REPOSITORY), str(REPOSITORY / "tests" / "made_up"), str(hidden)])
    done = subprocess.run(
        [sys.executable, "-c", code, "train", "toy_system", "--lake", str(lake)],
        capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path, "METASCENES_CACHE": str(tmp_path / "c")}, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.strip().endswith("train: torch: is not installed; pip install 'metascenes[train]', or `make train` in a checkout")
