"""How large a lake is: every file counts once, and what is said to be of no use is what a vacuum removes."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from flows.cli import cli
from schemas.capture import Scene
from schemas.tables import TABLES
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.lake_load import scene_id
from tests.whole_scenes import stage_whole_scene
from warehouse.lake import Lake
from warehouse.questions.sql import query
from warehouse.release import make_release
from warehouse.upkeep.sizes import UNNAMED, Held, LakeSize, Size, measure
from warehouse.upkeep.vacuum import vacuum


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    """Three commits of two scenes, the second of which takes the first one's rows away; a blob for nobody, and one that is staged."""
    lake = Lake.open(tmp_path / "lake")
    for number, (scene, tag) in enumerate(((0, "old"), (0, "new"), (1, "new"))):
        stage_whole_scene(lake, scene_id(scene), tag, at=number)
        lake.commit(str(number))
    lake.blobs.put(b"of nobody", "glb")
    waiting = lake.blobs.put(b"of a run that is not committed", "glb")
    rows = [sample(Scene, scene_id=scene_id(2), mesh_blob=waiting)]
    lake.stage_rows(stage_run(scene_id(2), "capture", fingerprint("waits"), at=9), {"scenes": rows})
    return lake


def files_below(folder: Path) -> Held:
    found = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    return Held(len(found), sum(found))


def by_name(measured: LakeSize) -> dict[str, Size]:
    return {size.name: size for size in measured.parts}


@pytest.mark.whole
def test_every_file_counts_once_and_rows_are_those_of_sql(lake: Lake) -> None:
    make_release(lake, "v1")
    measured, root = measure(lake), Path(lake.address)
    assert measured.total().all == files_below(root)
    assert measured.total(measured.tables).all == files_below(root / "tables")
    assert measured.total(measured.blobs).all == files_below(root / "blobs")
    assert by_name(measured)["releases/"].all == files_below(root / "releases")
    reader = lake.snapshot()
    assert measured.snapshot_id == reader.snapshot_id == 3
    for size in measured.tables:
        assert size.rows == query(reader, f"SELECT count(*) AS n FROM {size.name}").to_pylist()[0]["n"]
        files = [root / file for file in reader.files(size.name)]
        assert size.live == Held(len(files), sum(file.stat().st_size for file in files))
        assert size.all == files_below(root / "tables" / size.name)
    assert {size.name for size in measured.tables} >= {name for name in TABLES if reader.arrow(name).num_rows}


@pytest.mark.whole
def test_blobs_count_for_the_column_that_names_them_by_what_they_are_good_for(lake: Lake) -> None:
    columns = [(table.name, column) for table in TABLES.values() for column in table.blob_columns]
    at = {number: {} for number in (1, 2, 3)}
    for number, named in at.items():
        for table, column in columns:
            for blob in lake.snapshot(number).arrow(table).column(column).to_pylist():
                if blob is not None:
                    named.setdefault(blob, f"{table}.{column}")
    root = Path(lake.address, "blobs")
    expected: dict[str, dict[str, Held]] = {}
    for path in root.rglob("*.*"):
        live = path.name in at[3]
        older = {**at[2], **at[1]}.get(path.name)
        name = at[3].get(path.name) or older or UNNAMED
        kind = "live" if live else "older" if older else "live" if "not committed" in path.read_text() else "unnamed"
        part = expected.setdefault(name, {})
        part[kind] = part.get(kind, Held()) + Held(1, path.stat().st_size)
    measured = measure(lake).blobs
    assert {size.name: size for size in measured} == {name: Size(name, None, **kinds) for name, kinds in expected.items()}
    assert all(size.older.files for size in measured if size.name == "scenes.mesh_blob")
    assert by_name(measure(lake))[UNNAMED].live.files == by_name(measure(lake))[UNNAMED].unnamed.files == 1


@pytest.mark.whole
def test_what_is_of_no_use_is_what_a_vacuum_removes(lake: Lake) -> None:
    for path in Path(lake.address, "blobs").rglob("*.*"):
        os.utime(path, (0, 0))
    before = measure(lake)
    assert before.total().older.bytes
    tables = before.total(size for size in before.tables if size.name != "snapshots")  # whose one file is written anew
    snapshots, blobs = by_name(before)["snapshots"], before.total(before.blobs)
    freed = vacuum(lake, days=0)
    assert freed.file_bytes == (tables.older + tables.unnamed + snapshots.live + snapshots.unnamed).bytes
    assert (freed.blobs, freed.blob_bytes) == ((blobs.older + blobs.unnamed).files, (blobs.older + blobs.unnamed).bytes)
    after = measure(lake)
    assert after.total().older == after.total().unnamed == Held()
    assert after.total(after.blobs).live == blobs.live
    assert [(size.name, size.rows) for size in after.tables if size.name != "snapshots"] == [
        (size.name, size.rows) for size in before.tables if size.name != "snapshots"
    ]


def test_a_lake_without_rows_is_measured(tmp_path: Path) -> None:
    measured = measure(Lake.open(tmp_path / "lake"))
    assert (measured.snapshot_id, measured.tables, measured.blobs) == (0, (), ())
    assert measured.total() == Size("", 0)


@pytest.mark.whole
def test_the_command_says_the_same_in_words_and_as_json(lake: Lake) -> None:
    measured = measure(lake)
    said = CliRunner().invoke(cli, ["lake", "size", "--lake", lake.address, "--json"])
    told = json.loads(said.stdout)
    assert [part["name"] for part in told["blobs"]] == [size.name for size in measured.blobs]
    for part in (*told["tables"], *told["blobs"], *told["folders"]):
        size = by_name(measured)[part["name"]]
        assert (part["files"], part["bytes"], part["older_bytes"]) == (size.all.files, size.all.bytes, size.older.bytes)
    assert told["total"]["bytes"] == files_below(Path(lake.address)).bytes
    words = CliRunner().invoke(cli, ["lake", "size", "--lake", lake.address]).stdout
    assert f"in {measured.total().all.files} files at snapshot 3" in words
    assert next(line for line in words.splitlines() if line.startswith("instances ")).split()[1] == str(by_name(measured)["instances"].rows)
