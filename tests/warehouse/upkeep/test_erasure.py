"""Erasure: a scene leaves the lake without a trace, others keep every row, and a kill at any step changes nothing of that."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import flows.scans.erasure
from flows.cli import cli
from flows.scans.erasure import erase_from_caches, search_temporary
from flows.scans.mirror import facts_of
from schemas.errors import InputError
from schemas.machine.scratch import temporary_folder
from schemas.runs import Snapshot, StageRun
from schemas.tables import TABLES
from tasks.pipeline import SCENE_STAGES
from tests.conftest import REPOSITORY
from tests.samples import fingerprint, stage_run
from tests.whole_scenes import stage_batch, stage_whole_scene
from warehouse.lake import Lake
from warehouse.release import make_release, releases
from warehouse.sharing.writer import new_token, this_writer
from warehouse.tables.digest import digests
from warehouse.upkeep import erasure
from warehouse.upkeep.erasure import erase
from warehouse.upkeep.erasure.proof import Proof, search
from warehouse.upkeep.erasure.traces import Traces, traces_of
from warehouse.upkeep.inspection import inspect

pytestmark = [pytest.mark.whole, pytest.mark.usefixtures("own_machine")]

SCENES = [f"demo/scene{number:04d}_00" for number in range(3)]
HOME = SCENES[1]


def fill(lake: Lake, scene: str | None = HOME, release: bool = True) -> None:
    """A lake with history: scenes, batches, releases, a removed scene, staged runs. Without `scene`, it was never there."""
    for number, one in enumerate(SCENES):
        if one == scene or one != HOME:
            stage_whole_scene(lake, one, "old", at=number, shared=min(number, 1))
    lake.commit(f"{scene} and others" if scene else "erased and others")
    if release:
        make_release(lake, "v1", notes=f"has {scene or 'erased'}")
    kept = [one for one in SCENES if one == scene or one != HOME]
    stage_batch(lake, "mixed", kept, at=10)
    if scene:
        stage_batch(lake, "own", [scene], at=11)
        stage_whole_scene(lake, scene, "new", at=12, shared=1)
    failed = stage_run(
        SCENES[0], "exports", fingerprint("f"), at=13, outcome="failed", error=f"differs from {scene or 'erased'}", error_kind="input"
    )
    lake.stage_rows(failed)
    lake.commit("second")


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    lake = Lake.open(tmp_path_factory.mktemp("filled") / "lake")
    fill(lake)
    return Path(lake.address)


@pytest.fixture
def lake(filled: Path, tmp_path: Path) -> Lake:
    shutil.copytree(filled, tmp_path / "lake")
    return Lake.open(tmp_path / "lake")


def texts(value: Any) -> list[str]:
    """All texts in a Python value."""
    if isinstance(value, str):
        return [value]
    if isinstance(value, dict):
        return [text for item in value.values() for text in texts(item)]
    return [text for item in value for text in texts(item)] if isinstance(value, list) else []


def found_in(folder: Path, *words: str) -> list[str]:
    """Files that hold a word: by `grep` in their bytes and names, by Arrow in what Parquet files decode to."""
    hits = []
    for word in words:
        told = subprocess.run(["grep", "-rlaF", word, str(folder)], capture_output=True, text=True, check=False).stdout
        hits += told.split()
    for path in folder.rglob("*"):
        if any(word in str(path.relative_to(folder)) for word in words):
            hits.append(str(path))
        if path.is_file() and path.read_bytes()[:4] == b"PAR1":
            decoded = texts(pq.read_table(io.BytesIO(path.read_bytes())).to_pylist())
            hits += [str(path) for text in decoded for word in words if word in text]
    return sorted(set(hits))


def rows_of_others(lake: Lake, snapshot_id: int | None = None) -> dict[str, list[Any]]:
    """Rows of all tables but what is about HOME, as plain values."""
    reader = lake.snapshot(snapshot_id)
    own_assets = {row["asset_id"] for row in reader.arrow("candidates").to_pylist() if row["scene_id"] == HOME}
    own_assets -= {row["asset_id"] for row in reader.arrow("candidates").to_pylist() if row["scene_id"] != HOME}
    found = {}
    for table in TABLES:
        if table not in ("snapshots", "releases"):
            rows = reader.arrow(table).to_pylist()
            rows = [r for r in rows if r.get("scene_id") not in (HOME, "own", "own-runs") and r.get("batch_id") not in ("own", "own-runs")]
            rows = [r for r in rows if r.get("room_id") != HOME]
            found[table] = [r for r in rows if r.get("asset_id") not in own_assets] if table in ("assets", "texture_charts") else rows
    return found


def seen(lake: Lake, snapshot_id: int | None = None) -> dict[str, Any]:
    """What a snapshot says; how many rows a batch once had is history, and stays what it was."""
    reader = lake.snapshot(snapshot_id)
    runs = [dataclasses.replace(run, row_counts=()) for run in reader.rows(StageRun) if run.outcome != "failed"]
    told = sorted((run.scene_id, run.stage, run.fingerprint, run.outcome, run.upstream, run.degradations) for run in runs)
    return digests(reader) | {"stage_runs": told}


def test_the_scene_is_gone_and_the_others_keep_every_row(lake: Lake) -> None:
    folder = Path(lake.address)
    stage_whole_scene(lake, HOME, "staged", at=20)
    own = {row["mesh_blob"] for row in lake.snapshot().arrow("scenes", HOME).to_pylist()}
    before = {number: rows_of_others(lake, number) for number in (1, 2)}
    blobs = set(lake.blobs)
    assert found_in(folder, "scene0001_00")
    told = erase(lake, HOME, dry_run=True)
    assert told.proof is None
    assert digests(lake.snapshot()) == digests(Lake.open(lake.address).snapshot())
    assert (told.rows["instances"], told.rows["annotations"], told.rows["trajectories"]) == (2, 4, 2)
    assert told.staged_runs == len(SCENE_STAGES)
    done = erase(lake, HOME)
    assert (done.rows, done.staged_runs, done.blobs) == (told.rows, told.staged_runs, told.blobs)
    assert done.proof is not None
    assert done.proof.hits == ()
    assert done.proof.files == sum(1 for path in folder.rglob("*") if path.is_file() and path.name != "lease.json") + 1
    names = [name.partition(".")[0] for name in blobs - set(lake.blobs)]
    assert own
    assert {name.partition(".")[0] for name in own} <= set(names)
    assert found_in(folder, "scene0001_00", "scene0001%", *names) == []
    reader = lake.snapshot()
    assert [row.note for row in reader.snapshots] == ["erased and others", "second", "erasure"]
    for number in (1, 2, 3):
        expected = before[min(number, 2)]
        for table, rows in rows_of_others(lake, number).items():
            assert [{**row, "error": None} for row in rows] == [{**row, "error": None} for row in expected[table]] or table != "stage_runs"
            if table != "stage_runs":
                assert rows == expected[table], (number, table)
    errors = {row.error for row in reader.rows(StageRun)} - {None}
    assert errors == {"differs from erased"}
    (release,) = releases(lake)
    assert (release.notes, release.scenes, len(release.erased_at)) == ("has erased", 2, 1)
    assert pq.read_table(folder / "releases/v1/scenes.parquet").column("scene_id").to_pylist() == [SCENES[0], SCENES[2]]
    assert [str(finding) for finding in inspect(lake).findings] == []


@pytest.mark.slow
def test_the_lake_is_as_if_the_scene_had_never_been_there(lake: Lake, tmp_path: Path) -> None:
    erase(lake, HOME)
    other = Lake.open(tmp_path / "other")
    fill(other, None)
    assert seen(lake) == seen(other)
    assert seen(lake, 1) == seen(other, 1)
    assert set(other.blobs) <= set(lake.blobs)
    # It goes on from there, the erased scene included.
    stage_whole_scene(lake, HOME, "again", at=30)
    stage_whole_scene(other, HOME, "again", at=30)
    lake.commit()
    other.commit()
    assert seen(lake) == seen(other)


def test_again_finds_nothing_and_changes_nothing(lake: Lake) -> None:
    erase(lake, HOME)
    before = [row.snapshot_id for row in lake.snapshot().snapshots]
    done = erase(lake, HOME)
    assert (done.rows, done.blobs, done.snapshots) == ({}, 0, ())
    assert done.proof is not None
    assert done.proof.hits == ()
    assert [row.snapshot_id for row in lake.snapshot().snapshots] == before


def test_a_scene_that_was_removed_before_is_erased_from_history(lake: Lake) -> None:
    """Nothing names it any more but old snapshots, logs with its name in a predicate, and a note."""
    lake.remove_scene(HOME)
    assert found_in(Path(lake.address), "scene0001_00")
    done = erase(lake, HOME)
    assert done.proof is not None
    assert done.proof.hits == ()
    assert found_in(Path(lake.address), "scene0001_00") == []


def test_staged_batches_are_settled_first(lake: Lake) -> None:
    stage_batch(lake, "late", [SCENES[0], HOME], at=40)
    done = erase(lake, HOME)
    assert done.proof is not None
    assert done.proof.hits == ()
    assert lake.storage.names("staged") == []
    assert {row["batch_id"] for row in lake.snapshot().arrow("annotations").to_pylist()} == {"mixed", "late"}


def test_no_text_of_ours_in_a_release_looks_like_a_scene(tmp_path: Path) -> None:
    """An example in the catalog once named the first scene of the demo, whose erasure was never proven therefore."""
    lake = Lake.open(tmp_path / "lake")
    for scene in SCENES[:2]:
        stage_whole_scene(lake, scene, "old", at=0)
    lake.commit()
    make_release(lake, "v1")
    done = erase(lake, "demo/scene0000_00")
    assert done.proof is not None
    assert done.proof.hits == ()


def test_what_cannot_be_erased_is_found_and_the_exit_code_says_so(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    stranger = Path(lake.address) / "notes.txt"
    stranger.write_text("the home of scene0001_00")

    def run(*arguments: str) -> Any:
        return CliRunner().invoke(cli, ["lake", "erase", HOME, "--lake", lake.address, *arguments])

    assert run().exit_code == 2
    assert "--yes" in run().output
    answer = run("--dry-run", "--json")
    assert answer.exit_code == 0
    assert json.loads(answer.output)["rows"]["scenes"] == 1
    answer = run("--yes", "--json")
    assert answer.exit_code == 1
    assert [hit["path"] for hit in json.loads(answer.output)["proof"]["hits"]] == ["notes.txt"]
    stranger.unlink()
    answer = run("--yes")
    assert answer.exit_code == 0
    assert ": 0 hits" in answer.output


def test_what_a_killed_release_left_goes_too(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    fill(lake, release=False)  # a release that is made anew would remove it by the way
    left = tmp_path / "lake" / "tmp" / f"{this_writer().machine}-999999-1-1"
    left.mkdir(parents=True)
    pq.write_table(lake.snapshot().arrow("scenes"), left / "scenes.parquet")
    living = tmp_path / "lake" / "tmp" / new_token()
    living.mkdir()
    (living / "README.md").write_text("of nobody")
    done = erase(lake, HOME)
    assert done.proof is not None
    assert done.proof.hits == ()
    assert not left.exists()
    assert (living / "README.md").exists()


def test_blobs_that_may_be_of_the_scene_are_no_proof(lake: Lake) -> None:
    """A vacuum took away the rows that said whose a blob is, and the blob is too young to go."""
    command = ["lake", "erase", HOME, "--yes", "--lake", lake.address]
    name = lake.blobs.put(b"whose mesh is this?", "glb")
    found = CliRunner().invoke(cli, command)
    assert found.exit_code == 1
    assert "not proven" in found.output
    path = lake.blobs.path(name)
    for blob in lake.blobs:
        os.utime(lake.blobs.path(blob), (0, 0))
    found = CliRunner().invoke(cli, command)
    assert (found.exit_code, "not proven" in found.output) == (0, False), found.output
    assert not path.exists()


@pytest.mark.slow
def test_what_another_run_took_the_place_of_before_a_commit_goes_too(lake: Lake) -> None:
    """Nothing names its blobs, and they are young; but they tell of the scene."""
    for tag in ("first", "second"):
        stage_whole_scene(lake, HOME, tag, at=50 if tag == "first" else 60)
    lake.commit("recaptured")
    written = [path for path in found_in(Path(lake.address), HOME) if "/blobs/" in path]
    assert any(b"first" in Path(path).read_bytes() for path in written)
    done = erase(lake, HOME)
    assert done.proof is not None
    assert done.proof.hits == ()
    assert found_in(Path(lake.address), "scene0001_00") == []


def test_names_that_are_no_scene_are_refused(lake: Lake, tmp_path: Path) -> None:
    for wrong in ("scene0001_00", "demo/", "demo/x'; DROP TABLE scenes; --", "../x"):
        with pytest.raises(InputError, match="is no scene"):
            erase(lake, wrong)
    with pytest.raises(InputError, match="there is no lake"):
        erase(Lake.open(tmp_path / "none"), HOME)
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_unfinished_erasure_of_another_scene_comes_first(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("warehouse.upkeep.erasure.erase_from_releases", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            erase(lake, HOME)
    with pytest.raises(InputError, match=f"the erasure of {HOME} is not finished"):
        erase(lake, SCENES[0])
    assert any(finding.kind == "erasure" for finding in inspect(lake).errors)
    assert erase(lake, HOME).proof.hits == ()  # type: ignore[union-attr]


NAMES = st.sampled_from(["s1_00", "s1_001", "as1_00", "s1_00_b", "s1_00.x", "s1-00", "scene1_00", "S1_00", "kitchen", "kitchen2", "s1_0"])


@pytest.mark.slow
@settings(max_examples=3, deadline=None, suppress_health_check=list(HealthCheck))
@given(scenes=st.lists(st.tuples(st.sampled_from(["a", "b.c", "a_b"]), NAMES), min_size=2, max_size=4, unique=True), data=st.data())
def test_scenes_with_similar_names_keep_their_rows(
    tmp_path_factory: pytest.TempPathFactory, scenes: list[tuple[str, str]], data: Any
) -> None:
    """One's name is a part of another's, datasets share a scan's name, rooms are shared or not."""
    names = [f"{dataset}/{scan}" for dataset, scan in scenes]
    rooms = {name: data.draw(st.sampled_from([name, "a/room"])) for name in names}
    gone = data.draw(st.sampled_from(names))
    lakes = []
    for present in (names, [name for name in names if name != gone]):
        lake = Lake.open(tmp_path_factory.mktemp("similar") / "lake")
        for number, name in enumerate(present):
            stage_whole_scene(lake, name, "x", at=number, room=rooms[name])
        stage_batch(lake, "batch", present, at=50)
        lake.commit()
        lakes.append(lake)
    done = erase(lakes[0], gone)
    assert done.proof is not None
    assert done.proof.hits == ()
    assert seen(lakes[0]) == seen(lakes[1])
    assert gone not in {text for table in TABLES for text in texts(lakes[0].snapshot().arrow(table).to_pylist())}


WORD = st.text(st.sampled_from("ab1_-./ "), max_size=6)


@given(before=WORD, after=WORD, others=st.lists(st.sampled_from(["a/s1_00_b", "a/s1_001", "b/xs1_00", "a_b/s1_00"]), unique=True))
def test_traces_in_texts_are_those_of_an_independent_reading(before: str, after: str, others: list[str]) -> None:
    """A name counts where it stands alone and no other scene's longer name covers it."""
    traces = traces_of("a/s1_00", ["a/s1_00"], others)
    text = f"{before}a/s1_00{after}"
    spared = {name: spelled for other in others for name in traces.spared for spelled in [other] if name}
    start, end = len(before), len(before) + len("a/s1_00")
    alone = not before[-1:].isalnum() and not after[:1].isalnum()
    covers = [
        (found.start(), found.end())
        for name in spared
        for found in re.finditer(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])", text)
        if found.start() <= start and found.end() >= end
    ]
    if alone and not covers:
        assert traces.in_text(text)
        assert not traces.in_text(traces.redacted(text))
    if not alone:
        assert text[start:end] in traces.redacted(text) or covers or traces.redacted(text) != text


@given(before=st.text(), after=st.text(st.sampled_from(' "./\n'), max_size=3), ascii=st.booleans())
def test_names_are_found_behind_every_escape_of_json(before: str, after: str, ascii: bool) -> None:
    traces = traces_of("a/s1_00", ["a/s1_00"], [])
    text = f"{before}a/s1_00{after}"
    if traces.in_text(text):
        assert traces.in_text(json.dumps(text, ensure_ascii=ascii))


def test_common_words_are_no_traces() -> None:
    """A scan may be called `kitchen`; other rows may say so, too."""
    traces = traces_of("house/kitchen", ["house/kitchen"], ["house/bedroom"])
    assert not traces.in_text("a kitchen cabinet")
    assert traces.in_text("/export/house_kitchen/scene.usda")
    assert traces.redacted("a kitchen of house/kitchen") == "a kitchen of erased"
    telling = traces_of("scannet/scene0707_00", ["scannet/scene0707"], ["scannet/scene0707_01", "scannet/scene0708_00"])
    assert telling.in_text("/data/scene0707_00_vh_clean_2.ply")
    assert not telling.in_text("/data/scene0707_01_vh_clean_2.ply")


@pytest.mark.parametrize("pack", ["plain", "gzip", "zip", "parquet", "nested", "dictionary", "name", "duckdb", "sqlite"])
def test_the_search_looks_into_everything(tmp_path: Path, pack: str) -> None:
    import gzip
    import zipfile

    import duckdb

    lake = Lake.open(tmp_path / "lake")
    lake.blobs.put(b"x", "glb")
    word = "of scene0001_00 and others"
    file = tmp_path / "lake" / ("scene0001_00" if pack == "name" else "file")
    if pack == "plain":
        file.write_text(word)
    elif pack == "gzip":
        file.write_bytes(gzip.compress(word.encode()))
    elif pack == "zip":
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed:
            packed.writestr("a", word * 9)
    elif pack == "duckdb":
        with duckdb.connect(str(file)) as connection:
            connection.execute(f"CREATE TABLE t AS SELECT '{word}' || range AS x FROM range(5000)")
    elif pack == "sqlite":
        # A text that is longer than a page: no run of bytes of the file holds all of the name.
        with contextlib.closing(sqlite3.connect(file)) as connection:
            connection.execute("PRAGMA page_size = 512")
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("CREATE TABLE t (x TEXT)")
            connection.executemany("INSERT INTO t VALUES (?)", [("-" * (number % 512) + word,) for number in range(2048)])
            connection.commit()
    elif pack == "name":
        file.write_bytes(b"")
    else:
        plain = pa.array([word] * 3)
        columns = {"parquet": plain, "nested": pa.array([[[word]], [], None]), "dictionary": plain.dictionary_encode()}
        pq.write_table(pa.table({"x": columns[pack]}), file, compression="zstd", write_statistics=False, store_schema=pack == "dictionary")
    traces = Traces(frozenset(["scene0001_00"]))
    assert {hit.path for hit in search(lake.storage, traces).hits} == {file.name}
    assert search(lake.storage, Traces(frozenset(["scene0002_00"]))).hits == ()
    blob = Traces(frozenset(["nothing"]), hashes=frozenset([next(iter(lake.blobs)).partition(".")[0]]))
    assert [hit.place for hit in search(lake.storage, blob).hits] == ["name"]


def test_the_machines_caches_forget(tmp_path: Path) -> None:
    gone, stays = "a" * 64, "b" * 64
    for key in (f"{gone}.glb", f"{stays}.glb"):
        path = tmp_path / "modules" / "tasks.geometry.meshes-1" / key
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    pieces = tmp_path / "modules" / "tasks.geometry.pieces-1" / ("c" * 64)
    pieces.parent.mkdir()
    pieces.write_bytes(b"x")
    store = tmp_path / "file_hashes.json"
    store.write_text(json.dumps({"/scans/scene0001_00/x.ply": [1, 2, 3, 4, "h"], "/scans/scene0002_00/x.ply": [1, 2, 3, 4, "h"]}))
    traces = Traces(frozenset(["scene0001_00"]))
    assert erase_from_caches(traces, [], tmp_path) == 1
    assert pieces.exists()
    assert erase_from_caches(traces, [gone], tmp_path) == 2
    assert [path.name for path in tmp_path.glob("modules/*/*")] == [f"{stays}.glb"]
    assert list(json.loads(store.read_text())) == ["/scans/scene0002_00/x.ply"]
    assert erase_from_caches(traces, [gone], tmp_path / "none") == 0


def kept(lake: Lake) -> list[Any]:
    """The snapshots that are there, by what they say, and the releases."""
    rows = [(row.snapshot_id, row.note, seen(lake, row.snapshot_id)) for row in lake.snapshot().snapshots]
    # v2 is made between two attempts: of a killed one it tells, by the notes of v1, and is written again.
    erased = {release.name: len(release.erased_at) for release in releases(lake) if release.name != "v2"}
    return [rows, [(release.name, release.snapshot_id, release.notes, erased.get(release.name)) for release in releases(lake)]]


@pytest.mark.parametrize(
    ("step", "others"),
    [
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in [
                ("_remove_staged", "idle"),
                ("_put_in_force", "idle"),
                ("_put_in_force", "commit"),
                ("_remove_blobs", "idle"),
                ("final", "commit"),
            ]
        ),
        ("_put_in_force", "release"),
    ],
)
def test_a_repeated_erasure_keeps_the_snapshots_of_an_undisturbed_one(
    filled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, others: str
) -> None:
    """Others may commit or release between the two attempts, as they could after an undisturbed one."""
    lakes = []
    for name in ("killed", "undisturbed"):
        shutil.copytree(filled, tmp_path / name)
        lakes.append(Lake.open(tmp_path / name))
    killed, undisturbed = lakes

    def die(*arguments: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        if step != "final":
            real = getattr(erasure._Work, step)

            def then_die(*arguments: Any) -> None:
                real(*arguments)
                die()

            patch.setattr(erasure._Work, step, then_die)
        with pytest.raises(KeyboardInterrupt):
            erase(killed, HOME, elsewhere=die)
    erase(undisturbed, HOME)
    for lake in lakes if others != "idle" else ():
        if others == "commit":
            lake.stage_rows(stage_run(SCENES[0], "exports", fingerprint("g"), at=70, outcome="failed", error="full", error_kind="input"))
            lake.commit("meanwhile")
        else:
            make_release(lake, "v2")
    done = erase(killed, HOME)
    assert done.proof is not None
    assert done.proof.hits == ()
    assert kept(killed) == kept(undisturbed)
    assert inspect(killed).findings == ()


@pytest.mark.whole
@pytest.mark.parametrize("step", [pytest.param("_remove_staged", marks=pytest.mark.slow), "_put_in_force"])
def test_the_plan_of_an_earlier_version_is_carried_out(filled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    """It does not say which snapshot was the last one: an older erasure's snapshot is not taken for its own."""
    shutil.copytree(filled, tmp_path / "lake")
    lake = Lake.open(tmp_path / "lake")
    erase(lake, SCENES[-1])
    first = lake.snapshot().snapshots[-1]
    lake.stage_rows(stage_run(SCENES[0], "exports", fingerprint("g"), at=70, outcome="failed", error="full", error_kind="input"))
    lake.commit("meanwhile")
    real = getattr(erasure._Work, step)

    def then_die(*arguments: Any) -> None:
        real(*arguments)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(erasure._Work, step, then_die)
        with pytest.raises(KeyboardInterrupt):
            erase(lake, HOME)
    plan = Path(lake.address) / "erasure.json"
    fields = json.loads(plan.read_text())
    assert fields.pop("last") == first.snapshot_id + 1
    plan.write_text(json.dumps(fields))
    erase(lake, HOME)
    rows = lake.snapshot().snapshots
    assert [row.snapshot_id for row in rows if row.note == erasure.NOTE] == [rows[-1].snapshot_id]
    assert rows[-1].snapshot_id > first.snapshot_id + 1


def test_a_plan_without_the_last_snapshot_takes_only_younger_snapshots_for_its_own(tmp_path: Path) -> None:
    start = datetime(2030, 1, 1, tzinfo=UTC)
    storage = Lake.open(tmp_path / "lake").storage
    plan = erasure.ErasurePlan(HOME, start, traces_of(HOME, [HOME], SCENES), frozenset(), frozenset(), frozenset(), 0)
    rows = [Snapshot(snapshot_id=7, created_at=start + timedelta(days=days), tables=(), note=erasure.NOTE) for days in (-1, 1)]
    for last, expected in ((None, [False, True]), (0, [True, True]), (7, [False, False])):
        dataclasses.replace(plan, last=last).write(storage)
        found = erasure.read_plan(storage)
        assert found is not None
        assert (found.last, [erasure._is_marker(row, found) for row in rows]) == (last, expected)
    fields = json.loads(storage.read("erasure.json"))
    storage.write("erasure.json", json.dumps({name: value for name, value in fields.items() if name != "last"}).encode())
    found = erasure.read_plan(storage)
    assert found is not None
    assert found.last is None


def kills(folder: Path, filled: Path, *arguments: str) -> list[dict[str, Any]]:
    command = [sys.executable, "-m", "tests.warehouse.upkeep.upkeep_kills", *arguments, str(filled), str(folder)]
    answer = subprocess.run(
        command, cwd=REPOSITORY, capture_output=True, text=True, timeout=1500, env=os.environ | {"OMP_NUM_THREADS": "1"}
    )
    assert answer.returncode == 0, answer.stderr
    return [json.loads(line) for line in answer.stdout.splitlines()]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_an_erasure_that_dies_at_any_step_is_finished_by_the_next(filled: Path, tmp_path: Path) -> None:
    results = kills(tmp_path / "work", filled, "erase", HOME)
    undisturbed = results[-1]
    assert undisturbed["code"] == 0
    assert len(results) > 15, "every kind of step was killed"
    for result in results[:-1]:
        assert result["code"] == 9, result
        assert result["before"] in (undisturbed["first"], undisturbed["after"]), f"step {result['step']}: all of the scene, or nothing"
        assert result["after"] == undisturbed["after"], f"step {result['step']}"
        assert result["kept"] == undisturbed["kept"], f"step {result['step']}: another snapshot was dropped"
        assert result["hits"] == 0, result
        assert result["findings"] == [], result
    states = [result["before"] == undisturbed["after"] for result in results[:-1]]
    assert states == sorted(states), "once it is in force it stays"
    assert {True, False} == set(states)


@pytest.mark.slow
def test_snapshots_say_nothing_of_the_scene(lake: Lake) -> None:
    done = erase(lake, HOME)
    rows = [dataclasses.asdict(row) for row in lake.snapshot().snapshots]
    assert HOME not in json.dumps(rows, default=str)
    assert done.releases == ("v1",)


NESTED = "[" * 200_000


@pytest.mark.parametrize("damage", [NESTED, f'{{"scan": {NESTED}', "[1]", "{", '{"scene": 3, "files": [1]}', "\\xff"])
def test_damaged_records_of_caches_stop_no_erasure(tmp_path: Path, damage: str) -> None:
    """A record that cannot be read may be about the scene: it goes with its version, and is made again when it is needed."""
    versions = tmp_path / "scans" / "store" / "versions"
    for name, text in (("a-1", damage), ("b-2", json.dumps({"scene": SCENES[0], "scan": "x", "content": "x", "files": {}}))):
        (versions / name / "content").mkdir(parents=True)
        (versions / f"{name}.json").write_text(text)
    (tmp_path / "file_hashes.json").write_text(damage)
    is_record = damage.startswith('{"scene"')
    assert facts_of(versions / "a-1.json") == (json.loads(damage) if is_record else {})
    assert facts_of(versions / "none.json") == {}
    erase_from_caches(traces_of(HOME, [HOME], SCENES), [], tmp_path)
    assert sorted(path.name for path in versions.iterdir()) == (["a-1", "a-1.json"] if is_record else []) + ["b-2", "b-2.json"]
    assert (tmp_path / "file_hashes.json").exists() == is_record


def test_temporary_folders_that_tell_of_the_scene_are_found_and_dead_ones_go(lake: Lake, own_machine: Path) -> None:
    places = own_machine / "tmp"
    command = ["lake", "erase", HOME, "--yes", "--lake", lake.address, "--json"]
    with temporary_folder() as living:
        dead, strange = places / re.sub(r"-\d+-[0-9a-f]+-\w+$", "-999999-1-x", living.name), places / "other"
        for place in (dead, living, strange):
            place.mkdir(exist_ok=True)
            (place / "mesh.txt").write_text(f"of {HOME}")
        answer = CliRunner().invoke(cli, command)
        assert answer.exit_code == 1
        assert [hit["path"] for hit in json.loads(answer.output)["proof"]["hits"]] == [str(living / "mesh.txt")]
        assert [place.exists() for place in (dead, living, strange)] == [False, True, True], "folders of others are not looked at"
    answer = CliRunner().invoke(cli, command)
    assert (answer.exit_code, json.loads(answer.output)["proof"]["hits"]) == (0, [])


def test_temporary_files_that_vanish_or_have_strange_names_stop_no_search(own_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = own_machine / "tmp" / "metascenes-trial"
    for name in ("first", "second"):
        (place / name).mkdir(parents=True)
    (place / os.fsdecode(b"scene0001_00_\xff")).write_text("short")
    real = flows.scans.erasure._search

    def search_and_remove(path: Path, traces: Traces) -> Proof:
        """Search a path; its owner removes the folders next to it meanwhile."""
        for name in ("first", "second"):
            if path.parent == place:
                shutil.rmtree(place / name, ignore_errors=True)
        return real(path, traces)

    monkeypatch.setattr(flows.scans.erasure, "_search", search_and_remove)
    hits = search_temporary(traces_of(HOME, [HOME], SCENES)).hits
    assert [(hit.path, hit.place) for hit in hits] == [(f"{place}/scene0001_00_\\xff", "name")]
