"""Kills of whatever works on a small lake: a short campaign with a fixed seed, and that its eyes would see a fault."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from bench.kills import campaign
from bench.kills.accounts import faults_of
from bench.kills.campaign import JOURNAL, KINDS, Campaign, clock_environment, faketime, read_journal, report, run_campaign
from bench.kills.disk import let_go, mounted
from bench.kills.operations import SCENES, Operation, age, perform, story
from flows.cli import cli
from flows.inputs.annotation import import_annotations
from schemas.annotation import Annotation
from schemas.errors import InputError
from schemas.runs import StageRun
from tests.conftest import REPOSITORY
from tests.samples import stage_run
from warehouse.lake import Lake
from warehouse.sharing.writer import this_writer

pytestmark = pytest.mark.whole


def batch(kind: str, seed: int, kills: int, folder: Path, **environment: str) -> dict[str, Any]:
    """What came of a batch of kills, done by a process of its own."""
    command = [sys.executable, "-m", "bench.kills.batches", kind, str(seed), str(kills), str(folder), str(folder / "peace")]
    done = subprocess.run(command, cwd=REPOSITORY, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.slow
def test_operations_that_are_killed_and_given_again_leave_the_lake_of_nobody_disturbed(tmp_path: Path) -> None:
    found = batch("lake", 6, 8, tmp_path)
    assert found["faults"] == []
    assert sum(found["kills"].values()) >= 8
    assert len(found["kills"]) > 3, "several kinds of operations were killed"


@pytest.mark.slow
def test_eight_writers_and_upkeep_that_are_killed_at_once_lose_nothing(tmp_path: Path) -> None:
    found = batch("writers", 1, 8, tmp_path)
    assert found["faults"] == []
    assert found["kills"]["writer of 8 at once"] >= 2


@pytest.mark.slow
def test_clocks_that_are_wrong_and_jump_change_nothing(tmp_path: Path) -> None:
    try:
        faketime()
    except InputError as error:
        pytest.skip(str(error))
    assert "40d" in json.dumps(clock_of("+40d")), "the library sets the clock"
    found = batch("clock", 2, 4, tmp_path, **clock_environment())
    assert found["faults"] == []
    assert sum(found["kills"].values()) >= 4


def clock_of(offset: str) -> dict[str, str]:
    """The offset, if a process that is given it sees a clock that is 40 days wrong."""
    code = f"import os, time; now = time.time(); os.environ['FAKETIME'] = {offset!r}; print(round((time.time() - now) / 86400))"
    said = subprocess.run([sys.executable, "-c", code], env=os.environ | clock_environment(), capture_output=True, text=True, check=True)
    return {"offset": offset} if said.stdout.strip() == "40" else {}


def test_a_disk_that_a_killed_batch_left_mounted_is_let_go(tmp_path: Path) -> None:
    place = tmp_path / "1" / "disk"
    disk = mounted(place, 2**20)
    try:
        disk.__enter__()
    except InputError as error:
        pytest.skip(str(error))
    assert place.is_mount()
    let_go(tmp_path)
    assert not place.is_mount()
    shutil.rmtree(tmp_path / "1")


@pytest.mark.slow
def test_disks_that_are_full_change_nothing(tmp_path: Path) -> None:
    found = batch("disk", 1, 6, tmp_path)
    if any("can be mounted" in fault for fault in found["faults"]):
        pytest.skip(found["faults"][0])
    assert found["faults"] == []
    assert sum(found["full"].values()) >= 6


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("kind", ["runs", "configs"])
def test_runs_that_are_killed_leave_the_lake_of_nobody_disturbed(tmp_path: Path, kind: str) -> None:
    found = batch(kind, 1, 4, tmp_path)
    assert found["faults"] == []
    assert sum(found["kills"].values()) >= 2


def told(place: Path, *operations: Operation) -> Path:
    place.mkdir()
    for operation in operations:
        perform(operation, place)
    return place / "lake"


@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two lakes with the same story."""
    folder = tmp_path_factory.mktemp("twins")
    scenes = [Operation("scene", SCENES[0]), Operation("scene", SCENES[1])]
    end = [Operation(name) for name in ("commit", "sweep", "age", "vacuum")]
    one, other = (told(folder / name, *scenes, Operation("commit"), Operation("release", "v1"), *end) for name in ("one", "other"))
    return one, other


@pytest.fixture
def copy(twins: tuple[Path, Path], tmp_path: Path) -> Path:
    shutil.copytree(twins[0], tmp_path / "lake")
    return tmp_path / "lake"


def test_a_sound_lake_has_no_faults(twins: tuple[Path, Path]) -> None:
    assert faults_of(*twins) == []


def test_the_accounts_see_what_lies_about_and_what_is_missing(copy: Path, twins: tuple[Path, Path]) -> None:
    left = [copy / "tmp" / "left", copy / "staged" / "left", copy / "claims" / "left.json", copy / "tables" / "captions" / "left.parquet"]
    for path in left:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"left")
    blobs = sorted(path for path in (copy / "blobs").rglob("*") if path.is_file())
    blobs[0].unlink()
    blobs[1].write_bytes(b"another")
    (copy / "blobs" / "nobodys.glb").write_bytes(b"left")
    (copy / "releases" / "v1" / "captions.parquet").write_bytes(b"")
    shutil.copy(twins[0] / "releases" / "v1" / "scenes.parquet", copy / "releases" / "v1" / "captions.parquet")
    found = faults_of(copy, twins[1])
    assert {f"leftover: {path.relative_to(copy)}" for path in left} <= set(found)
    assert f"orphan: rows name blob {blobs[0].name}, which is not there" in found
    assert f"blob {blobs[1].name}: its content is another" in found
    assert "orphan: no row names blob nobodys.glb" in found
    assert "release v1: captions.parquet is not what its sum says" in found
    assert any(line.startswith("release v1: captions: 4 rows lost") for line in found)


def test_the_accounts_see_rows_lost_and_doubled_and_work_done_twice(copy: Path, twins: tuple[Path, Path]) -> None:
    lake = Lake.open(copy)
    run = next(run for run in lake.snapshot().rows(StageRun) if run.stage == "captions")
    lake.stage_rows(dataclasses.replace(run, attempt=2, row_counts=()), {})  # again, and this time it gave no rows
    assert lake.commit() is not None
    lake.sweep()
    found = faults_of(copy, twins[1], swept=False)
    assert "captions: 2 rows lost, 0 too many or others" in found
    assert f"stage_runs: {run.scene_id} captions: done 2 times instead of 1" in found
    log = max((copy / "tables" / "scenes" / "_delta_log").glob("*.json"))
    added = next(line for line in log.read_text().splitlines() if '"add"' in line)
    name = json.loads(added)["add"]["path"]
    shutil.copy(copy / "tables" / "scenes" / name, copy / "tables" / "scenes" / f"again-{name}")
    log.write_text(log.read_text().rstrip("\n") + "\n" + added.replace(name, f"again-{name}") + "\n")
    found = faults_of(copy, twins[1], swept=False)
    assert "scenes: 2 rows doubled" in found


def test_stories_of_many_seeds_end_in_peace_without_kills(tmp_path: Path) -> None:
    """Only what is possible is told: an operation that is refused would look like a fault."""
    import random

    names = set()
    for seed in range(300):
        operations = story(random.Random(seed), 20)
        names |= {operation.name for operation in operations}
        assert [operation.name for operation in operations[-4:]] == ["commit", "sweep", "age", "vacuum"]
    assert len(names) == 13
    told(tmp_path / "place", *story(random.Random(5), 12))


def test_a_campaign_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[str, int]] = []

    def stub(config: Campaign, kind: str, number: int, kills: int) -> dict[str, Any]:
        made.append((kind, number))
        line = {"kind": kind, "kills": {"commit at a step": kills}, "full": {}, "operations": 1, "faults": [], "seconds": 36.0}
        return line | {"campaign": config.seed, "number": number}

    monkeypatch.setattr(campaign, "_batch", stub)
    kinds = ("lake", "writers")
    first = run_campaign(Campaign(tmp_path, kills=50, seed=3, kinds=kinds))
    assert made == [("lake", 0), ("writers", 1)]
    with (tmp_path / JOURNAL).open("a") as file:
        file.write('{"kind": "lake", "kil')  # as a kill leaves it
        file.write("\n")
    again = run_campaign(Campaign(tmp_path, kills=60, seed=3, kinds=kinds))
    assert made[2:] == [("lake", 2)]
    assert (sum(first["kills"].values()), sum(again["kills"].values())) == (50, 60)
    assert again["hours"] == pytest.approx(0.03)
    assert run_campaign(Campaign(tmp_path, kills=60, seed=3, kinds=kinds))["kills"] == again["kills"]
    assert read_journal(tmp_path / JOURNAL, 4) == []
    assert len(made) == 3
    assert run_campaign(Campaign(tmp_path, kills=1, minutes=0, seed=9, kinds=kinds))["kinds"] == {}


def test_a_fault_is_told_and_ends_with_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    line = {"kind": "lake", "kills": {"commit at a step": 2}, "full": {"scene": 1}, "operations": 1, "faults": ["captions: 1 rows doubled"],
            "seconds": 1.0, "campaign": 0, "number": 0}  # fmt: skip
    monkeypatch.setattr(campaign, "_batch", lambda *_: line)
    command = ["bench", "chaos", "--kills", "2", "--kinds", "lake", "--folder", str(tmp_path / "chaos")]
    found = CliRunner().invoke(cli, command)
    assert (found.exit_code, "lake 0: captions: 1 rows doubled" in found.output) == (1, True)
    shown = json.loads(CliRunner().invoke(cli, [*command, "--json"]).output)
    assert shown["faults"] == ["lake 0: captions: 1 rows doubled"]
    assert report([], 0)["goals"][1]["met"] is False, "without kills the zeros say nothing"
    assert CliRunner().invoke(cli, ["bench", "chaos", "--kinds", "nothing"]).exit_code == 2
    assert set(KINDS) == {"lake", "writers", "clock", "disk", "clock writers", "runs", "configs"}


def test_a_batch_that_dies_is_a_fault(tmp_path: Path) -> None:
    found = campaign._batch(Campaign(tmp_path), "no such kind", 7, 1)
    assert found["faults"] == ["the batch ended with 1: ValueError: 'no such kind' is no kind of batch"]
    assert (tmp_path / "batch7" / "stderr.log").exists()


def left_by_the_dead(lake: Lake, stage: str) -> None:
    """Let the staged files of a stage be those of a process that died."""
    token = f"{this_writer().machine}-999999-1-1"
    for path in (Path(lake.address) / "staged").glob(f"*@{stage}@*"):
        parts = path.name.split("@")
        path.rename(path.with_name("@".join([*parts[:3], token, parts[4]])))


def batch_of_answers(place: Path) -> Path:
    told(place, Operation("scene", SCENES[0]), Operation("commit"), Operation("batch", json.dumps([SCENES[0]]), 1))
    return place / "batches" / "batch-1.json"


def test_an_import_of_annotations_that_died_before_its_commit_is_not_done_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = batch_of_answers(tmp_path / "place")
    lake = Lake.open(tmp_path / "place" / "lake")
    with monkeypatch.context() as patched:
        patched.setattr(Lake, "commit", lambda *_, **__: None)  # killed once its rows are staged
        import_annotations(lake, file)
    left_by_the_dead(lake, "annotation")
    assert import_annotations(lake, file, dry_run=True)["already"] is False
    assert lake.snapshot().rows(Annotation) == [], "a dry run changes nothing"
    assert import_annotations(lake, file)["already"] is True
    assert [run.attempt for run in lake.snapshot().rows(StageRun) if run.stage == "annotation"] == [1]
    assert len(lake.snapshot().rows(Annotation)) == 2
    assert lake.storage.names("staged") == []


def test_erasure_takes_what_a_killed_import_left_half_staged(tmp_path: Path) -> None:
    from warehouse.upkeep.erasure import erase

    place = tmp_path / "place"
    file = batch_of_answers(place)
    lake = Lake.open(place / "lake")
    lake.stage_rows(stage_run("batch-0", "annotation", "0" * 64), {"annotations": _answers(lake, file)})
    for path in (Path(lake.address) / "staged").glob("*@stage_runs.parquet"):
        path.unlink()  # killed between the rows and the run's own row
    left_by_the_dead(lake, "annotation")
    done = erase(lake, SCENES[0])
    assert done.proof is not None
    assert done.proof.hits == ()
    assert lake.storage.names("staged") == []


def _answers(lake: Lake, file: Path) -> list[Any]:
    """Rows of a batch, as its import would stage them, under another batch's name."""
    import_annotations(lake, file)
    return [dataclasses.replace(row, batch_id="batch-0") for row in lake.snapshot().rows(Annotation)]


def test_who_is_second_to_create_a_file_is_told_so_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both saw no file: the link that fails says who was first, and is no refusal of the system's."""
    from warehouse.storage.files import LocalStorage

    storage = LocalStorage(tmp_path)
    assert storage.create("lease.json", b"first")
    monkeypatch.setattr(LocalStorage, "exists", lambda self, path: False)
    assert storage.create("lease.json", b"second") is False
    assert storage.read("lease.json") == b"first"
    assert list((tmp_path / "tmp").iterdir()) == []


def test_blobs_are_aged(tmp_path: Path) -> None:
    path = tmp_path / "blobs" / "a"
    path.parent.mkdir()
    path.write_bytes(b"x")
    before = path.stat().st_mtime
    age(tmp_path)
    assert before - path.stat().st_mtime > 86_400
