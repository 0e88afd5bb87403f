"""Releases and vacuum: what is kept stays readable whatever is removed around it."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from flows.cli import cli
from schemas.captions import Caption
from schemas.errors import InputError
from schemas.record import arrow_to_rows
from schemas.runs import Release
from schemas.tables import TABLES
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.lake_load import scene_id, stage_scene
from warehouse.lake import Lake
from warehouse.questions.sql import query
from warehouse.release import make_release, releases
from warehouse.tables.delta import nullable
from warehouse.tables.digest import blob_names, digests
from warehouse.tables.released import folder_of
from warehouse.upkeep.vacuum import vacuum


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four snapshots, each with other rows of the same two scenes."""
    lake = Lake.open(tmp_path_factory.mktemp("filled") / "lake")
    for i in range(4):
        for number in range(2):
            stage_scene(lake, number, i, at=10 * i + number)
        lake.commit(f"run {i}")
    return Path(lake.address)


@pytest.fixture
def lake(filled: Path, tmp_path: Path) -> Lake:
    shutil.copytree(filled, tmp_path / "lake")
    return Lake.open(tmp_path / "lake")


def data_files(lake: Lake) -> int:
    return sum(1 for _ in Path(lake.address).glob("tables/*/*.parquet"))


def age(lake: Lake) -> None:
    """Let all blobs be old."""
    for path in Path(lake.address, "blobs").rglob("*.*"):
        os.utime(path, (0, 0))


@pytest.mark.whole
def test_release_is_plain_parquet_of_its_snapshot(lake: Lake) -> None:
    release = make_release(lake, "2026.1", snapshot_id=2, notes="for the paper")
    assert releases(lake) == [release]
    assert (release.snapshot_id, release.notes) == (2, "for the paper")
    folder = Path(lake.address) / folder_of(release.name)
    reader = lake.snapshot(2)
    for name, table in TABLES.items():
        data = pq.read_table(folder / f"{name}.parquet")
        assert data.equals(reader.arrow(name).cast(nullable(table.arrow_schema)))
        assert data.schema.field(0).metadata[b"description"].decode() == table.columns[0].description
    assert (folder / "tables.md").read_text().startswith("# Tables")
    for wrong, message in (("2026.1", "is released already"), ("../x", "cannot be a name"), ("", "cannot be a name")):
        with pytest.raises(InputError, match=message):
            make_release(lake, wrong)
    with pytest.raises(InputError, match="the lake has snapshots 1 to 4"):
        make_release(lake, "new", snapshot_id=9)


def test_empty_lake_has_nothing_to_release(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    with pytest.raises(InputError, match="no snapshot yet"):
        make_release(lake, "x")
    assert releases(lake) == []
    assert vacuum(lake).snapshots == ()
    assert not (tmp_path / "lake").exists()


@pytest.mark.whole
def test_vacuum_keeps_what_releases_and_the_last_snapshot_name(lake: Lake) -> None:
    make_release(lake, "kept", snapshot_id=2)
    before = {i: (digests(lake.snapshot(i)), blob_names(lake.snapshot(i))) for i in (2, 4)}
    files = data_files(lake)
    age(lake)
    assert vacuum(lake, days=0, dry_run=True).snapshots == (1, 3)
    assert data_files(lake) == files
    found = vacuum(lake, days=0)
    assert found.snapshots == (1, 3)
    assert found.files > 0
    assert data_files(lake) < files
    for i in (2, 4):
        assert digests(lake.snapshot(i)) == before[i][0]
        assert all(lake.blobs[name] for name in before[i][1])
    assert set(lake.blobs) == before[2][1] | before[4][1]
    assert found.blobs == 4
    with pytest.raises(InputError, match="the lake has snapshots 2, 4"):
        lake.snapshot(3)
    stage_scene(lake, 0, "after", at=99)
    snapshot = lake.commit()
    assert snapshot is not None
    assert snapshot.snapshot_id == 5
    assert len(lake.snapshot().rows(Caption)) == 10
    assert digests(lake.snapshot(2)) == before[2][0]
    assert vacuum(lake, days=0).snapshots == (4,)
    assert digests(lake.snapshot(2)) == before[2][0]
    assert len(lake.snapshot().rows(Caption)) == 10


def test_vacuum_leaves_recent_snapshots_and_fresh_or_staged_blobs(lake: Lake) -> None:
    assert vacuum(lake).snapshots == ()
    assert len(lake.snapshot(1).rows(Caption)) == 10
    fresh = lake.blobs.put(b"not named yet", "glb")
    stage_scene(lake, 5, "staged", at=99)
    staged = set(lake.blobs)
    age(lake)
    assert lake.blobs.put(b"not named yet", "glb") == fresh, "put again, so it is fresh again"
    vacuum(lake, days=0)
    left = set(lake.blobs)
    assert fresh in left
    lake.commit()
    assert blob_names(lake.snapshot()) <= left < staged
    age(lake)
    vacuum(lake, days=0)
    assert set(lake.blobs) == blob_names(lake.snapshot())


def test_commit_that_died_before_a_vacuum_is_still_made_good(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    from warehouse.tables.commit import Commit

    lake.stage_rows(stage_run(scene_id(0), "captions", fingerprint("x"), at=99), {"captions": [sample(Caption, scene_id=scene_id(0))]})
    with monkeypatch.context() as patch:
        patch.setattr(Commit, "_write_snapshot", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            lake.commit()
    before = digests(lake.snapshot())
    vacuum(lake, days=0)
    assert digests(lake.snapshot()) == before
    lake.commit()
    assert len(lake.snapshot().rows(Caption)) == 6


@pytest.mark.whole
def test_releases_are_a_table_of_what_was_released_until_then(lake: Lake) -> None:
    assert lake.snapshot().rows(Release) == []
    assert query(lake.snapshot(), "SELECT * FROM releases").num_rows == 0
    first = make_release(lake, "v1", snapshot_id=2, notes="it's \"the\" first;\n-- 'quoted'")
    second = make_release(lake, "v2")
    for snapshot_id, known in ((None, [first, second]), (4, [first, second]), (3, [first]), (2, [first]), (1, [])):
        reader = lake.snapshot(snapshot_id)
        assert reader.rows(Release) == known
        asked = query(reader, "SELECT * FROM releases ORDER BY name")
        assert arrow_to_rows(asked, Release) == known
        assert asked.schema.names == TABLES["releases"].arrow_schema.names
    assert (
        query(lake.snapshot(), "SELECT scenes, rooms, objects FROM releases WHERE name = 'v1'").to_pylist()
        == query(lake.snapshot(2), "SELECT scenes, rooms, objects FROM headline").to_pylist()
    )
    counts = dict(entry.split("=") for entry in second.row_counts)
    assert counts.keys() == TABLES.keys()
    assert int(counts["captions"]) == lake.snapshot().arrow("captions").num_rows > 0


@pytest.mark.whole
def test_questions_can_be_asked_of_a_release(lake: Lake) -> None:
    make_release(lake, "v1", snapshot_id=2)
    asked = ["sql", "SELECT max(snapshot_id) AS last FROM snapshots", "--output", "csv", "--lake", lake.address]
    run = CliRunner().invoke
    assert run(cli, [*asked, "--release", "v1"]).output.split() == ["last", "2"]
    assert run(cli, [*asked, "--snapshot", "3"]).output.split() == ["last", "3"]
    assert run(cli, asked).output.split() == ["last", "4"]
    assert "no release 'v9'; there are: v1" in str(run(cli, [*asked, "--release", "v9"]).exception)
    assert "give one of them" in str(run(cli, [*asked, "--release", "v1", "--snapshot", "3"]).exception)


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize("damage", ["", "{", '{"name": "v1"}', '{"name": "v2"'])
def test_a_damaged_record_of_a_release_is_named(lake: Lake, damage: str) -> None:
    make_release(lake, "v1")
    path = Path(lake.address, "releases", "v1", "release.json")
    path.write_text(path.read_text().replace('"name": "v1"', damage) if "v2" in damage else damage)
    with pytest.raises(InputError, match=r"releases/v1/release.json"):
        releases(lake)
