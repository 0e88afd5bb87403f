"""The lake: what a commit adopts, replaces, withdraws and shares, on real Delta tables, read back in SQL."""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import json
import os
import pickle
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from schemas.annotation import Annotation
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance, Scene
from schemas.errors import InputError, LakeError, RecordError
from schemas.navigation import Split
from schemas.runs import Snapshot, StageRun
from schemas.selection import Selection
from schemas.tables import TABLES
from tasks import pipeline
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.questions.renames import former_columns, move_out_of
from warehouse.questions.sql import query
from warehouse.sharing.writer import new_token, this_writer
from warehouse.tables import adoption
from warehouse.tables.digest import blob_names, digests

A, B, C = "demo/a_00", "demo/b_00", "demo/c_00"


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return Lake.open(tmp_path / "lake")


def stage(lake: Lake, scene: str, name: str, print_: str, *upstream: str, at: float = 0.0, **tables: Sequence[Any]) -> StageRun:
    run = stage_run(scene, name, print_, *upstream, at=at)
    lake.stage_rows(run, tables)
    return run


def scene_row(lake: Lake, scene: str, **values: Any) -> Scene:
    return sample(Scene, scene_id=scene, room_id=scene[:-3], mesh_blob=lake.blobs.put(scene.encode(), "glb"), **values)


def captions(scene: str, *sentences: str) -> list[Caption]:
    return [sample(Caption, scene_id=scene, instance_id=f"{i:04d}", sentence=text) for i, text in enumerate(sentences)]


def assets(lake: Lake, *names: str, **values: Any) -> list[Asset]:
    blob = lake.blobs.put(b"mesh", "glb")
    return [sample(Asset, asset_id=fingerprint(name), name=name, mesh_blob=blob, **values) for name in names]


def candidates(scene: str, *names: str) -> list[Candidate]:
    return [sample(Candidate, scene_id=scene, instance_id="0001", slot=i + 1, asset_id=fingerprint(name)) for i, name in enumerate(names)]


def walked(lake: Lake, scene: str, tag: str = "1", at: float = 0.0, **tables: Sequence[Any]) -> None:
    """Capture, captions and candidates of a scene, as one run of the pipeline stages them."""
    one, two = fingerprint(scene, tag, "capture"), fingerprint(scene, tag, "captions")
    stage(lake, scene, "capture", one, at=at, scenes=[scene_row(lake, scene)])
    stage(lake, scene, "captions", two, f"capture={one}", at=at + 1, captions=tables.get("captions", captions(scene, tag, "x")))
    given_assets = tables.get("assets", assets(lake, scene))
    stage(
        lake, scene, "candidates", fingerprint(scene, tag, "candidates"), f"capture={one}", f"captions={two}", at=at + 2,
        candidates=tables.get("candidates", candidates(scene, scene)), assets=given_assets,
    )  # fmt: skip


def files(folder: Path, within: str = "") -> set[str]:
    return {str(path.relative_to(folder)) for path in (folder / within).rglob("*") if path.is_file()}


def names_of(lake: Lake, table: str, column: str) -> list[Any]:
    return lake.snapshot().arrow(table).column(column).to_pylist()


def test_opening_and_reading_create_nothing(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "deep" / "lake")
    assert lake.snapshot().versions == {}
    assert lake.snapshot().snapshot_id == 0
    assert lake.history() == {}
    assert lake.commit() is None
    assert lake.remove_scene(A) is None
    lake.sweep()
    assert query(lake.snapshot(), "SELECT count(*) AS n FROM captions").to_pylist() == [{"n": 0}]
    assert list(lake.blobs) == []
    assert not (tmp_path / "deep").exists()


def test_every_table_reads_empty_under_its_schema(lake: Lake) -> None:
    stage(lake, A, "captions", fingerprint(1), captions=captions(A, "x"))
    lake.commit()
    reader = lake.snapshot()
    with reader.connect() as connection:
        for table in TABLES.values():
            described = connection.sql(f"DESCRIBE {table.name}").fetchall()
            moved = move.columns if (move := move_out_of(table.name)) else ()  # asked under their old table for one version
            old = (*former_columns(table.name), *moved)
            assert [row[0] for row in described] == [*(c.name for c in table.columns), *old]
            assert reader.arrow(table.name).schema.names == [c.name for c in table.columns]
            comments = dict(
                connection.execute("SELECT column_name, comment FROM duckdb_columns() WHERE table_name = ?", [table.name]).fetchall()
            )
            assert {name: text for name, text in comments.items() if name not in old} == {c.name: c.comment for c in table.columns}
            comment = connection.execute("SELECT comment FROM duckdb_views() WHERE view_name = ?", [table.name]).fetchall()
            assert comment == [(table.description,)]


def test_folder_with_other_objects_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("do not touch")
    lake = Lake.open(tmp_path)
    with pytest.raises(InputError, match=r"no lake but holds other files \(thesis.tex"):
        stage(lake, A, "captions", fingerprint(1))
    with pytest.raises(InputError, match="other files"):
        lake.blobs.put(b"x", "glb")
    assert files(tmp_path) == {"thesis.tex"}


@pytest.mark.parametrize("name", ["notes.txt", "deep/notes.txt", "my-2024-notes-1", "deadbeef-2024-1-notes"])
def test_folder_with_others_temporary_objects_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "tmp" / name).parent.mkdir(parents=True)
    (tmp_path / "tmp" / name).write_text("do not touch")
    lake = Lake.open(tmp_path)
    with pytest.raises(InputError, match=rf"no lake but holds other files \(tmp/{name.partition('/')[0]}, "):
        stage(lake, A, "captions", fingerprint(1))
    lake.sweep()
    assert files(tmp_path) == {f"tmp/{name}"}


@pytest.mark.parametrize("token", [new_token(), f"{this_writer().machine}-999999-1-1"], ids=["living", "dead"])
def test_folder_in_which_another_first_write_began_becomes_a_lake(tmp_path: Path, token: str) -> None:
    (tmp_path / "tmp").mkdir()
    (tmp_path / "tmp" / token).write_text("half a marker")
    lake = Lake.open(tmp_path)
    stage(lake, A, "captions", fingerprint(1), captions=captions(A, "x"))
    assert lake.commit() is not None


def test_address_that_is_a_file_or_below_one_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "scan.ply"
    file.write_text("ply")
    with pytest.raises(InputError, match=r"^\S+/scan\.ply: this is a file, not a folder; give a new or empty folder$"):
        Lake.open(file)
    with pytest.raises(InputError, match=r"^\S+/scan\.ply/a/lake: lies below \S+/scan\.ply, which is no folder; give .*$"):
        Lake.open(str(file / "a" / "lake"))
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    with pytest.raises(InputError, match="this is a file, not a folder"):
        Lake.open(tmp_path / "link")
    (tmp_path / "folder").mkdir()
    (tmp_path / "way").symlink_to(tmp_path / "folder")
    stage(Lake.open(tmp_path / "way"), A, "captions", fingerprint(1))
    assert "lake.json" in files(tmp_path / "folder")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder in which nobody can make one")
def test_folder_that_cannot_be_made_is_refused() -> None:
    lake = Lake.open("/proc/nope/lake")
    assert lake.history() == {}
    with pytest.raises(InputError, match=r"^/proc/nope/lake: the lake's folder cannot be made or written to \(.+\); give a folder"):
        lake.stage_rows(stage_run(A, "captions", fingerprint(1)))
    with pytest.raises(InputError, match="/proc/nope/lake: the lake's folder cannot be made"):
        lake.blobs.put(b"x", "glb")


@pytest.mark.parametrize("code", [errno.EROFS, errno.EACCES])
def test_lake_that_cannot_be_written_to_can_be_read(lake: Lake, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    stage(lake, A, "captions", fingerprint(1), captions=captions(A, "x"))
    lake.commit()

    def refused(path: Any, mode: str = "r", *rest: Any, **named: Any) -> Any:
        if "x" in mode:
            raise OSError(code, os.strerror(code), str(path))
        return open(path, mode, *rest, **named)

    monkeypatch.setattr("warehouse.storage.files.open", refused, raising=False)
    with pytest.raises(InputError, match=rf"cannot be made or written to \({os.strerror(code)}\)"):
        stage(lake, A, "captions", fingerprint(2), at=1, captions=captions(A, "y"))
    assert lake.snapshot().rows(Caption) == captions(A, "x")


def test_lake_of_a_newer_format_is_refused(tmp_path: Path) -> None:
    (tmp_path / "lake.json").write_text(json.dumps({"format": 99}))
    with pytest.raises(InputError, match="format 99"):
        Lake.open(tmp_path)
    (tmp_path / "lake.json").write_text("{")
    with pytest.raises(InputError, match="cannot be read"):
        Lake.open(tmp_path)


@pytest.mark.parametrize("name", ["a b é", "q'uote", "100%", "plus+"])
def test_address_may_hold_unusual_characters(tmp_path: Path, name: str) -> None:
    lake = Lake.open(tmp_path / name / "lake")
    stage(lake, A, "captions", fingerprint(1), captions=captions(A, "x"))
    lake.commit()
    stage(lake, A, "captions", fingerprint(2), at=1, captions=captions(A, "y"))
    lake.commit()
    assert query(lake.snapshot(), "SELECT sentence FROM captions").to_pylist() == [{"sentence": "y"}]
    assert [row.sentence for row in lake.snapshot(1).rows(Caption)] == ["x"]


@pytest.mark.parametrize("name", ["hash#tag", "star*", "what?", "[x]", "back\\slash", "a%20b"])
def test_address_that_would_be_misread_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="choose a folder without them"):
        Lake.open(tmp_path / name)


def test_unknown_address_is_refused() -> None:
    with pytest.raises(InputError, match="not supported"):
        Lake.open("ftp://bucket/lake")


def test_a_lake_is_its_address(lake: Lake) -> None:
    stage(lake, A, "captions", fingerprint(1), captions=captions(A, "x"))
    again = pickle.loads(pickle.dumps(lake))
    assert again.address == lake.address
    assert again.staged_rows("captions", A, fingerprint(1)) == captions(A, "x")


def test_staged_rows_are_for_their_own_run_until_they_are_committed(lake: Lake) -> None:
    walked(lake, A)
    assert lake.staged_rows("captions", A, fingerprint(A, "1", "captions")) == captions(A, "1", "x")
    assert lake.staged_rows("supports", A, fingerprint(A, "1", "captions")) is None
    assert lake.staged_rows("instances", A, fingerprint(A, "1", "capture")) == []
    assert lake.staged_rows("captions", A, fingerprint("other")) is None
    assert lake.staged_rows("captions", B, fingerprint(A, "1", "captions")) is None
    assert lake.snapshot().rows(Caption) == []
    snapshot = lake.commit("first")
    assert snapshot is not None
    assert (snapshot.snapshot_id, snapshot.note) == (1, "first")
    assert lake.staged_rows("captions", A, fingerprint(A, "1", "captions")) is None
    assert lake.rows_of("captions", A, fingerprint(A, "1", "captions")) == captions(A, "1", "x")
    assert lake.rows_of("captions", A, fingerprint("other")) is None
    assert lake.snapshot().rows(Caption, A) == captions(A, "1", "x")
    assert lake.snapshot().rows(Caption, B) == []
    assert files(Path(lake.address), "staged") == set()


def test_rows_replace_those_of_their_scene_only(lake: Lake) -> None:
    for scene in (A, B):
        stage(lake, scene, "captions", fingerprint(scene, 1), captions=captions(scene, "old", "old"))
    lake.commit()
    stage(lake, A, "captions", fingerprint(A, 2), at=1, captions=captions(A, "new"))
    lake.commit()
    assert [(row.scene_id, row.sentence) for row in lake.snapshot().rows(Caption)] == [(A, "new"), (B, "old"), (B, "old")]
    stage(lake, A, "captions", fingerprint(A, 3), at=2)
    lake.commit()
    assert [(row.scene_id, row.sentence) for row in lake.snapshot().rows(Caption)] == [(B, "old"), (B, "old")]


def test_time_travel(lake: Lake) -> None:
    for i in range(4):
        stage(lake, A, "captions", fingerprint(i), at=i, captions=captions(A, *[f"run {i}"] * (i + 1)))
        lake.commit(f"run {i}")
    for i in range(4):
        reader = lake.snapshot(i + 1)
        assert [row.sentence for row in reader.rows(Caption)] == [f"run {i}"] * (i + 1)
        seen = query(reader, "SELECT max(snapshot_id) AS last, (SELECT count(*) FROM stage_runs) AS runs FROM snapshots").to_pylist()
        assert seen == [{"last": i + 1, "runs": i + 1}]
        assert [row.note for row in reader.rows(Snapshot)] == [f"run {j}" for j in range(i + 1)]
    assert lake.snapshot().versions == lake.snapshot(4).versions
    for wrong in (0, 5):
        if wrong:
            with pytest.raises(InputError, match="the lake has snapshots 1 to 4"):
                lake.snapshot(wrong)
        else:
            assert lake.snapshot(0).rows(Caption) == []


def test_what_was_computed_from_changed_rows_is_withdrawn_with_all_that_follows(lake: Lake) -> None:
    walked(lake, A)
    walked(lake, B)
    stage(
        lake, A, "selection", fingerprint("s"), f"candidates={fingerprint(A, '1', 'candidates')}", at=3,
        selections=[sample(Selection, scene_id=A)],
    )  # fmt: skip
    lake.commit()
    before = lake.snapshot()
    stage(lake, A, "capture", fingerprint("changed"), at=10, scenes=[scene_row(lake, A, vertex_count=99)])
    assert lake.history()[A, "captions"].done is None
    lake.commit()
    reader = lake.snapshot()
    assert [row.vertex_count for row in reader.rows(Scene, A)] == [99]
    for table in ("captions", "candidates", "selections"):
        assert set(names_of(lake, table, "scene_id")) == ({B} if table != "selections" else set())
    assert [row.name for row in reader.rows(Asset)] == [B]
    history = lake.history()
    for name in ("captions", "candidates", "selection"):
        assert history[A, name].done is None
        assert history[A, name].last.outcome == "done"
        if name != "selection":
            assert history[B, name].done is not None
    assert [row.outcome for row in reader.rows(StageRun, A) if row.stage == "selection"] == ["done", "withdrawn"]
    assert before.rows(Caption, A) == captions(A, "1", "x"), "the old snapshot is still whole"


def test_same_fingerprint_again_keeps_what_follows(lake: Lake) -> None:
    walked(lake, A)
    lake.commit()
    stage(lake, A, "capture", fingerprint(A, "1", "capture"), at=10, scenes=[scene_row(lake, A)])
    lake.commit()
    assert lake.snapshot().rows(Caption) == captions(A, "1", "x")
    runs = [row for row in lake.snapshot().rows(StageRun) if row.stage == "capture"]
    assert [(row.attempt, row.snapshot_id) for row in runs] == [(1, 1), (2, 2)]


def test_run_on_rows_that_are_not_there_is_not_adopted(lake: Lake) -> None:
    stage(lake, A, "captions", fingerprint("c"), f"capture={fingerprint('missing')}", captions=captions(A, "x"))
    assert lake.commit() is None
    assert lake.history() == {}
    stage(lake, A, "capture", fingerprint("missing"), at=1, scenes=[scene_row(lake, A)])
    assert lake.commit() is not None
    assert lake.snapshot().rows(Caption) == captions(A, "x")


def test_upstream_entries_that_name_no_scene_stage_are_ignored(lake: Lake) -> None:
    others = ("annotations:123", "annotation=" + fingerprint("x"), "library=abc")
    stage(lake, A, "captions", fingerprint("c"), *others, captions=captions(A, "x"))
    assert lake.commit() is not None
    assert lake.snapshot().rows(Caption) == captions(A, "x")


def test_newest_of_several_staged_runs_wins_and_all_are_recorded(lake: Lake) -> None:
    for at, text in ((2.0, "late"), (0.0, "early"), (1.0, "middle")):
        stage(lake, A, "captions", fingerprint(text), at=at, captions=captions(A, text))
    lake.commit()
    assert [row.sentence for row in lake.snapshot().rows(Caption)] == ["late"]
    assert len(lake.snapshot().rows(StageRun)) == 3
    done = lake.history()[A, "captions"].done
    assert done is not None
    assert done.fingerprint == fingerprint("late")


def test_failure_leaves_its_row_and_the_old_rows(lake: Lake) -> None:
    stage(lake, A, "captions", fingerprint(1), captions=captions(A, "old"))
    lake.commit()
    error = "scene0001_00.txt: axisAlignment: determinant is 0; remove the line"
    failed = stage_run(A, "captions", fingerprint(2), at=1, outcome="failed", error=error, error_kind="input")
    lake.stage_rows(failed)
    assert lake.history()[A, "captions"].last.error == error
    lake.commit()
    state = lake.history()[A, "captions"]
    assert (state.last.outcome, state.last.error, state.last.fingerprint) == ("failed", error, fingerprint(2))
    assert state.done is not None
    assert state.done.fingerprint == fingerprint(1)
    assert [row.sentence for row in lake.snapshot().rows(Caption)] == ["old"]
    with pytest.raises(LakeError, match="must not leave rows"):
        lake.stage_rows(failed, {"captions": captions(A, "x")})


def test_failure_after_a_change_upstream_leaves_nothing_old(lake: Lake) -> None:
    walked(lake, A)
    lake.commit()
    stage(lake, A, "capture", fingerprint("new"), at=5, scenes=[scene_row(lake, A)])
    lake.stage_rows(stage_run(A, "captions", fingerprint("n"), f"capture={fingerprint('new')}", at=6, outcome="failed", error="x"))
    lake.commit()
    state = lake.history()[A, "captions"]
    assert (state.done, state.last.outcome, state.last.fingerprint) == (None, "failed", fingerprint("n"))
    assert lake.snapshot().rows(Caption) == []


def test_commit_of_some_scenes_leaves_the_others_staged(lake: Lake) -> None:
    for scene in (A, B, C):
        stage(lake, scene, "captions", fingerprint(scene), captions=captions(scene, "x"))
    assert lake.commit(scenes=()) is None
    lake.commit(scenes=[A, C])
    assert names_of(lake, "captions", "scene_id") == [A, C]
    assert lake.history()[B, "captions"].is_staged
    lake.commit()
    assert names_of(lake, "captions", "scene_id") == [A, B, C]


def test_shared_rows_live_as_long_as_somebody_names_them(lake: Lake) -> None:
    walked(lake, A, assets=assets(lake, "chair", "table"), candidates=candidates(A, "chair", "table"))
    walked(lake, B, assets=assets(lake, "chair", "mug"), candidates=candidates(B, "chair", "mug"))
    lake.commit()
    assert sorted(names_of(lake, "assets", "name")) == ["chair", "mug", "table"]
    version = lake.snapshot().versions["assets"]
    walked(lake, A, "2", at=10, assets=assets(lake, "table"), candidates=candidates(A, "table"))
    lake.commit()
    assert sorted(names_of(lake, "assets", "name")) == ["chair", "mug", "table"]
    assert lake.snapshot().versions["assets"] == version, "nothing changed, so nothing is written"
    lake.remove_scene(B)
    assert names_of(lake, "assets", "name") == ["table"]
    lake.remove_scene(A)
    assert names_of(lake, "assets", "name") == []
    assert sorted(row.name for row in lake.snapshot(1).rows(Asset)) == ["chair", "mug", "table"]


def test_shared_row_is_kept_once_and_renewed_by_newer_code(lake: Lake) -> None:
    for scene in (A, B):
        walked(lake, scene, assets=assets(lake, "chair"), candidates=candidates(scene, "chair"))
    lake.commit()
    assert len(lake.snapshot().rows(Asset)) == 1
    walked(lake, A, "2", at=10, assets=assets(lake, "chair", volume_m3=7.0), candidates=candidates(A, "chair"))
    lake.commit()
    assert [row.volume_m3 for row in lake.snapshot().rows(Asset)] == [7.0]


def test_shared_row_that_nobody_names_is_not_kept(lake: Lake) -> None:
    walked(lake, A, assets=assets(lake, "chair", "orphan"), candidates=candidates(A, "chair"))
    lake.commit()
    assert names_of(lake, "assets", "name") == ["chair"]


def test_splits_of_a_room_outlive_one_of_its_rescans(lake: Lake) -> None:
    for scene in ("demo/a_00", "demo/a_01"):
        one = fingerprint(scene)
        row = dataclasses.replace(scene_row(lake, scene), room_id="demo/a")
        stage(lake, scene, "capture", one, scenes=[row])
        stage(lake, scene, "navigation", fingerprint(scene, "n"), f"capture={one}", at=1, splits=[sample(Split, room_id="demo/a")])
    lake.commit()
    assert names_of(lake, "splits", "room_id") == ["demo/a"]
    lake.remove_scene("demo/a_00")
    assert names_of(lake, "splits", "room_id") == ["demo/a"]
    lake.stage_rows(stage_run("demo/a_01", "capture", fingerprint("other"), at=9), {"scenes": [scene_row(lake, "demo/a_01")]})
    lake.commit()
    assert names_of(lake, "splits", "room_id") == [], "the navigation that wrote it was withdrawn"


def test_annotations_are_history(lake: Lake) -> None:
    def answers(batch: str, *scenes: str, source: str = "f") -> list[Annotation]:
        return [sample(Annotation, batch_id=batch, scene_id=scene, source_file=source) for scene in scenes]

    stage(lake, "batch-1", "annotation", fingerprint(1), annotations=answers("batch-1", A, B))
    lake.commit()
    stage(lake, "batch-2", "annotation", fingerprint(2), at=1, annotations=answers("batch-2", A))
    lake.commit()
    stage(lake, "batch-1", "annotation", fingerprint(3), at=2, annotations=answers("batch-1", A, source="again"))
    lake.commit()
    found = [(row.batch_id, row.scene_id, row.source_file) for row in lake.snapshot().rows(Annotation)]
    assert found == [("batch-1", A, "again"), ("batch-1", B, "f"), ("batch-2", A, "f")]
    lake.remove_scene(A)
    assert len(lake.snapshot().rows(Annotation)) == 3, "people's answers stay"
    assert [row.batch_id for row in lake.snapshot().rows(Annotation, B)] == ["batch-1"]


def test_removed_scene_leaves_nothing_and_can_come_back(lake: Lake) -> None:
    for scene in (A, B):
        walked(lake, scene)
    lake.commit()
    full = digests(lake.snapshot())
    stage(lake, A, "capture", fingerprint("late"), at=9, scenes=[scene_row(lake, A)])
    lake.remove_scene(A)
    assert files(Path(lake.address), "staged") == set(), "what was staged of it is gone too"
    for table in TABLES.values():
        if table.rule == "replace" and table.owner:
            assert A not in names_of(lake, table.name, table.owner)
    assert all(state.done is None for (scene, _), state in lake.history().items() if scene == A)
    assert lake.remove_scene(A) is None
    walked(lake, A, at=20)
    lake.commit()
    assert digests(lake.snapshot()) == full


def test_rows_are_checked_before_anything_is_staged(lake: Lake) -> None:
    run = stage_run(A, "captions", fingerprint(1))
    with pytest.raises(RecordError, match=r"captions: row 0.*mass_kg: must be at least 0\.001"):
        lake.stage_rows(run, {"captions": [sample(Caption, scene_id=A, mass_kg=-1.0)]})
    with pytest.raises(RecordError, match=f"scene_id: must be the run's scene {A}, got {B}"):
        lake.stage_rows(run, {"captions": captions(B, "x")})
    with pytest.raises(LakeError, match="does not write supports"):
        lake.stage_rows(run, {"supports": []})
    with pytest.raises(RecordError, match=r"mesh_blob: must name a blob of the lake, got 'bbbb"):
        lake.stage_rows(stage_run(A, "capture", fingerprint(1)), {"scenes": [sample(Scene, scene_id=A)]})
    assert files(Path(lake.address), "staged") == set()


def test_row_counts_are_counted(lake: Lake) -> None:
    stage(lake, A, "captions", fingerprint(1), captions=captions(A, "x", "y"))
    assert lake.commit() is not None
    assert lake.snapshot().rows(StageRun)[0].row_counts == ("captions=2",)


def test_damaged_staged_run_is_lost_and_stops_nobody(lake: Lake) -> None:
    for scene in (A, B, C):
        walked(lake, scene)
    folder = Path(lake.address) / "staged"
    next(folder.glob("demo~2fa_00@captions@*@captions.parquet")).write_bytes(b"PAR1 nonsense")
    next(folder.glob("demo~2fb_00@captions@*@captions.parquet")).unlink()
    lake.commit()
    state = lake.history()
    assert state[A, "captions"].last.outcome == state[B, "captions"].last.outcome == "lost"
    assert "cannot be read" in str(state[A, "captions"].last.error)
    assert "is missing" in str(state[B, "captions"].last.error)
    assert set(names_of(lake, "captions", "scene_id")) == {C}
    assert set(names_of(lake, "scenes", "scene_id")) == {A, B, C}
    assert set(names_of(lake, "candidates", "scene_id")) == {C}, "what read the lost rows is not taken either"
    lake.sweep()
    assert files(Path(lake.address), "staged") == set()


def test_many_blobs_are_kept_as_one_by_one_and_none_under_a_false_name(lake: Lake) -> None:
    blobs = {f"{hashlib.sha256(data).hexdigest()}.bin": data for data in (str(k).encode() * 100 for k in range(300))}
    lake.blobs.put_all({})
    assert not lake.exists, "nothing was written"
    lake.blobs.put_all(blobs)
    assert set(lake.blobs) == set(blobs)
    assert all(lake.blobs[name] == data for name, data in blobs.items())
    lake.blobs.put_all(blobs)
    false = f"{hashlib.sha256(b'said').hexdigest()}.bin"
    with pytest.raises(LakeError, match="does not have the content"):
        lake.blobs.put_all({false: b"meant"})
    assert false not in lake.blobs


def test_no_blob_of_many_has_its_name_before_it_lasts(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of the system's calls: contents, their fsync, the name, the fsync of its folder."""
    blobs = {f"{hashlib.sha256(data).hexdigest()}.bin": data for data in (str(k).encode() * 100 for k in range(30))}
    synced: set[str] = set()
    named: dict[str, str] = {}

    def fsync(descriptor: int, real: Callable[[int], None] = os.fsync) -> None:
        real(descriptor)
        synced.add(os.readlink(f"/proc/self/fd/{descriptor}"))

    def replace(source: Path, target: Path, real: Callable[..., None] = os.replace) -> None:
        if target.parent.parent.parent.name == "blobs":
            assert source.read_bytes() == blobs[target.name]
            assert str(source.resolve()) in synced, "what has a name could be lost"
            named[target.name] = str(target.parent.resolve())
            synced.discard(named[target.name])
        real(source, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", replace)
    lake.blobs.put_all(blobs)
    assert set(named) == set(blobs)
    assert set(named.values()) <= synced, "a name could be lost"
    assert list((Path(lake.address) / "tmp").iterdir()) == []
    named.clear()
    lake.blobs.put_all(blobs)
    assert not named, "what is there is not written again"


def test_one_blob_of_many_that_cannot_be_kept_is_told(lake: Lake) -> None:
    blobs = {f"{hashlib.sha256(data).hexdigest()}.bin": data for data in (b"one", b"two", b"three")}
    in_the_way = Path(lake.address) / "blobs" / min(blobs)[:2]
    lake.blobs.put(b"first", "bin")
    assert not in_the_way.exists()
    in_the_way.write_bytes(b"")
    with pytest.raises((OSError, InputError)):
        lake.blobs.put_all(blobs)
    in_the_way.unlink()
    lake.blobs.put_all(blobs)
    assert set(lake.blobs) > set(blobs)


def test_blobs_are_written_once_and_checked(lake: Lake) -> None:
    name = lake.blobs.put(b"mesh", "glb")
    path = lake.blobs.path(name)
    assert path == Path(lake.address) / "blobs" / name[:2] / name[2:4] / name
    first = path.stat().st_mtime_ns
    assert lake.blobs.put(b"mesh", "glb") == name
    assert path.stat().st_mtime_ns == first
    assert lake.blobs[name] == b"mesh"
    assert name in lake.blobs
    assert list(lake.blobs) == [name]
    path.write_bytes(b"other")
    with pytest.raises(InputError, match="do not hash to its name"):
        lake.blobs[name]
    missing = "0" * 64 + ".glb"
    assert missing not in lake.blobs
    assert "../../etc/passwd" not in lake.blobs
    with pytest.raises(KeyError):
        lake.blobs[missing]
    with pytest.raises(InputError, match="no such blob"):
        lake.blobs.path(missing)
    for wrong in ("../x", "", name + "/.."):
        with pytest.raises(InputError, match="no blob name"):
            lake.blobs[wrong]


def test_reader_gives_rows_by_key(lake: Lake) -> None:
    walked(lake, A, assets=assets(lake, "chair", "table"), candidates=candidates(A, "chair", "table"))
    lake.commit()
    reader = lake.snapshot()
    assert [row.name for row in reader.rows_by_key(Asset, [fingerprint("table"), fingerprint("x")])] == ["table"]
    assert reader.rows_by_key(Asset, []) == []
    assert blob_names(reader) == {row.mesh_blob for row in (*reader.rows(Asset), *reader.rows(Scene))}
    with pytest.raises(InputError, match="the tables are scenes, shells, rooms"):
        reader.arrow("chairs")


def test_digest_does_not_see_times_hosts_order_or_batches(tmp_path: Path) -> None:
    found = []
    for i, batches in enumerate(([A, B, C], [C, B, A])):
        lake = Lake.open(tmp_path / str(i))
        for j, scene in enumerate(batches):
            if i:
                lake.stage_rows(stage_run(scene, "capture", fingerprint(scene, "1", "capture"), outcome="lost", at=j))
            walked(lake, scene, at=100.0 * i + j + 1)
            if i:
                lake.commit()
        lake.commit()
        found.append(digests(lake.snapshot()))
    assert found[0] == found[1]
    stage(lake, A, "captions", fingerprint("2"), at=999, captions=captions(A, "other"))
    lake.commit()
    changed = digests(lake.snapshot())
    assert changed.keys() == found[0].keys() == TABLES.keys() - {"snapshots", "releases", "refused_scans"} | {"blobs"}
    for table in ("captions", "stage_runs", "candidates", "assets"):  # the last two were withdrawn
        assert changed[table] != found[0][table]
    for table in ("scenes", "rooms", "annotations"):
        assert changed[table] == found[0][table]


def test_tables_stay_plain_parquet_with_descriptions(lake: Lake) -> None:
    from deltalake import DeltaTable

    stage(lake, A, "captions", fingerprint(1), captions=captions(A, "x"))
    lake.commit()
    folder = Path(lake.address) / "tables" / "captions"
    assert pq.read_table(next(folder.glob("*.parquet"))).column("sentence").to_pylist() == ["x"]
    table = DeltaTable(folder)
    assert table.metadata().name == "captions"
    assert table.metadata().description == TABLES["captions"].description
    fields = {field.name: field for field in table.schema().fields}
    for c in TABLES["captions"].columns:
        assert fields[c.name].metadata["description"] == c.description


@pytest.mark.whole
def test_many_small_commits_are_compacted_and_still_travel_in_time(lake: Lake) -> None:
    from warehouse.tables.delta import SMALL_FILES_BEFORE_COMPACTION as MOST

    count = MOST + 6
    for i in range(count):
        stage(lake, f"demo/s_{i:03d}", "captions", fingerprint(i), at=i, captions=captions(f"demo/s_{i:03d}", "x"))
        lake.commit()
    reader = lake.snapshot()
    assert len(reader.files("captions")) < 10
    assert len(reader.files("stage_runs")) < 10
    assert len(reader.files("snapshots")) == 1
    assert len(reader.rows(Caption)) == len(reader.rows(StageRun)) == len(lake.history()) == count
    for i in (1, MOST // 2, MOST, count):
        assert len(lake.snapshot(i).rows(Caption)) == i


def test_new_column_reads_as_missing_in_old_rows(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    """A lake that older code wrote: its Parquet files lack a column that the schema has now."""
    import schemas.record as record_module

    table = TABLES["supports"]
    older = dataclasses.replace(table, columns=tuple(c for c in table.columns if c.name != "parent_id"))
    real = record_module.table_of
    with monkeypatch.context() as patch:
        patch.setitem(TABLES, "supports", older)
        patch.setattr(record_module, "table_of", lambda kind: older if kind is table.record else real(kind))
        stage(lake, A, "optimization", fingerprint(1), supports=[sample(table.record, scene_id=A, parent_id="0009")])
        lake.commit()
    for scene_version in (1, 2):
        reader = lake.snapshot(scene_version) if scene_version == 1 else lake.snapshot()
        assert [row.parent_id for row in reader.rows(table.record, A)] == [None]
        sql = f"SELECT parent_id FROM supports WHERE scene_id = '{A}'"
        assert query(reader, sql).to_pylist() == [{"parent_id": None}]
        if scene_version == 1:
            stage(lake, B, "optimization", fingerprint(2), at=1, supports=[sample(table.record, scene_id=B, parent_id="0009")])
            lake.commit()
    assert [row.parent_id for row in lake.snapshot().rows(table.record, B)] == ["0009"]
    stage(lake, A, "optimization", fingerprint(3), at=2, supports=[sample(table.record, scene_id=A, parent_id="0007")])
    lake.commit()
    assert [row.parent_id for row in lake.snapshot().rows(table.record)] == ["0007", "0009"]


def test_a_column_may_be_described_anew(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    """A lake that older code wrote takes rows whose columns are described in other words now."""
    import schemas.record as record_module

    table = TABLES["supports"]
    columns = tuple(dataclasses.replace(c, description=f"formerly: {c.description}") for c in table.columns)
    older = dataclasses.replace(table, columns=columns)
    real = record_module.table_of
    with monkeypatch.context() as patch:
        patch.setitem(TABLES, "supports", older)
        patch.setattr(record_module, "table_of", lambda kind: older if kind is table.record else real(kind))
        stage(lake, A, "optimization", fingerprint(1), supports=[sample(table.record, scene_id=A, parent_id="0009")])
        lake.commit()
    for number, scene in ((2, B), (3, A)):  # added, and put in the place of old rows
        stage(
            lake, scene, "optimization", fingerprint(number), at=number, supports=[sample(table.record, scene_id=scene, parent_id="0007")]
        )
        lake.commit()
    assert [row.parent_id for row in lake.snapshot().rows(table.record)] == ["0007", "0007"]


def test_column_that_the_schema_has_no_more_is_not_shown(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    table = TABLES["supports"]
    stage(lake, A, "optimization", fingerprint(1), supports=[sample(table.record, scene_id=A)])
    lake.commit()
    younger = dataclasses.replace(table, columns=tuple(c for c in table.columns if c.name != "gap_m"))
    monkeypatch.setitem(TABLES, "supports", younger)
    monkeypatch.setattr("warehouse.questions.views.install", lambda connection, names: None)  # views may ask for the column
    assert "gap_m" not in query(lake.snapshot(), "SELECT * FROM supports").column_names
    assert "gap_m" not in lake.snapshot().arrow("supports").column_names


def test_threads_share_a_lake(lake: Lake) -> None:
    from concurrent.futures import ThreadPoolExecutor

    def work(number: int) -> list[Caption] | None:
        scene = f"demo/t{number:02d}"
        stage(lake, scene, "captions", fingerprint(scene), captions=captions(scene, "x"))
        found = lake.rows_of("captions", scene, fingerprint(scene))
        if number % 4 == 0:
            lake.commit()
        return found

    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(work, range(24)))
    assert [len(rows or ()) for rows in found] == [1] * 24
    lake.commit()
    assert len(lake.snapshot().rows(Caption)) == len(lake.snapshot().rows(StageRun)) == 24
    assert files(Path(lake.address), "staged") == set()


STEPS = st.lists(
    st.tuples(
        st.sampled_from(["capture", "captions", "candidates", "selection", "failed", "commit", "remove", "sweep"]),
        st.sampled_from([A, B]),
        st.integers(0, 2),
    ),
    min_size=3,
    max_size=20,
)
READS: Mapping[str, tuple[str, ...]] = {
    "capture": (),
    "captions": ("capture",),
    "candidates": ("capture", "captions"),
    "selection": ("candidates",),
}


@pytest.mark.whole
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=STEPS)
def test_lake_agrees_with_a_model_of_it(tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[str, str, int]]) -> None:
    """Random runs, commits and removals, beside a model that keeps plain dictionaries.

    Every run reads what the newest runs of the stages before it gave, staged or committed, as the pipeline does.
    Whatever happens, the lake holds for every scene a set of runs each of which read the others.
    """
    lake = Lake.open(tmp_path_factory.mktemp("model") / "lake")
    content: dict[tuple[str, str], str] = {}  # what a run left, by scene and fingerprint
    upstream: dict[tuple[str, str], tuple[str, ...]] = {}
    for at, (what, scene, tag) in enumerate(steps):
        if what == "commit":
            lake.commit()
        elif what == "remove":
            lake.remove_scene(scene)
            assert all(state.done is None for (one, _), state in lake.history().items() if one == scene)
        elif what == "sweep":
            before = {key: state.done and state.done.fingerprint for key, state in lake.history().items()}
            lake.sweep()
            assert {key: state.done and state.done.fingerprint for key, state in lake.history().items()} == before
        elif what == "failed":
            lake.stage_rows(stage_run(scene, "captions", fingerprint(scene, tag, "bad"), at=at, outcome="failed", error="no"))
        else:
            history = lake.history()
            above = [history.get((scene, name)) for name in READS[what]]
            if any(state is None or state.done is None for state in above):
                continue
            read = tuple(f"{state.stage}={state.done.fingerprint}" for state in above if state and state.done)
            print_ = fingerprint(scene, what, tag, *read)
            content[scene, print_], upstream[scene, print_] = str(tag), read
            rows: dict[str, Sequence[Any]] = {
                "capture": {"instances": [sample(Instance, scene_id=scene, raw_label=str(tag), points_blob=lake.blobs.put(b"p", "ply"))]},
                "captions": {"captions": captions(scene, str(tag))},
                "candidates": {"candidates": candidates(scene, str(tag)), "assets": assets(lake, str(tag))},
                "selection": {"selections": [sample(Selection, scene_id=scene, provider=str(tag))]},
            }[what]
            lake.stage_rows(stage_run(scene, what, print_, *read, at=at), rows)
            done = lake.history()[scene, what].done
            assert done is not None
            assert done.fingerprint == print_
        _check_consistent(lake, content, upstream)
    lake.commit()
    lake.sweep()
    assert files(Path(lake.address), "staged") == files(Path(lake.address), "tmp") == set()
    _check_consistent(lake, content, upstream)


def _check_consistent(lake: Lake, content: Mapping[tuple[str, str], str], upstream: Mapping[tuple[str, str], tuple[str, ...]]) -> None:
    """The snapshot's rows are those of its done runs, and each of these read rows that are there."""
    reader = lake.snapshot()
    current: dict[tuple[str, str], str] = {}
    for run in sorted(reader.rows(StageRun), key=lambda run: (run.snapshot_id, run.started_at)):
        if run.outcome == "done":
            current[run.scene_id, run.stage] = run.fingerprint
        elif run.outcome == "withdrawn":
            del current[run.scene_id, run.stage]
    for (scene, _), print_ in current.items():
        for entry in upstream[scene, print_]:
            name, _, read = entry.partition("=")
            assert current.get((scene, name)) == read
    seen = {"capture": ("instances", "raw_label"), "captions": ("captions", "sentence"), "selection": ("selections", "provider")}
    for name, (table, column) in seen.items():
        rows = reader.arrow(table).to_pylist()
        expected = {scene: content[scene, print_] for (scene, stage_name), print_ in current.items() if stage_name == name}
        assert {row["scene_id"]: row[column] for row in rows} == expected
        assert len(rows) == len(expected)
    named = {content[scene, print_] for (scene, name), print_ in current.items() if name == "candidates"}
    assert {row.name for row in reader.rows(Asset)} == named
    keys = [(run.scene_id, run.stage, run.fingerprint, run.attempt) for run in reader.rows(StageRun)]
    assert len(keys) == len(set(keys))


def test_order_of_stages_is_that_of_the_tables() -> None:
    assert tuple(stage.name for stage in pipeline.STAGES) == adoption.STAGES
    assert tuple(stage.name for stage in pipeline.SCENE_STAGES) == adoption.SCENE_STAGES
