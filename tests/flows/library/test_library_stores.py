"""Libraries of lakes in a store of objects, in backups and in releases."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from flows.library.adding import LakeShelf, contents_of
from flows.run.libraries import library_for_worker
from tasks.indexing import STAGE
from tests.flows.library.libraries import added, write_models
from tests.services import environment_of, s3_server
from warehouse.lake import Lake
from warehouse.release import make_release
from warehouse.tables.digest import digests
from warehouse.upkeep.backup import backup, restore
from warehouse.upkeep.inspection import inspect

pytestmark = pytest.mark.whole


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    return write_models(tmp_path / "chairs")


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    with s3_server() as s3, environment_of(s3):
        s3.make_bucket("lakes")
        yield "lakes"


@pytest.mark.s3
def test_a_store_of_objects_holds_what_a_folder_holds(bucket: str, tmp_path: Path, folder: Path) -> None:
    far, near = Lake.open(f"s3://{bucket}/lake"), Lake.open(tmp_path / "lake")
    rows = [added(lake, folder, processes=2) for lake in (far, near)]
    assert rows[0] == rows[1]
    assert sorted(far.blobs) == sorted(near.blobs)
    library = library_for_worker(far.address, "chairs", rows[0].library.content, None)
    assert library is not None
    assert library.search.files == ["a_chair.glb", "c_chair.obj"]
    assert [library.asset_of(file).asset.asset_id for file in library.search.files] == [
        row.asset_id for row in rows[0].models if row.duplicate_of is None
    ]
    assert LakeShelf(far).refresh(rows[0].models[0].model_blob)


def test_a_backup_and_a_release_have_it_all(tmp_path: Path, folder: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    contents = added(lake, folder)
    make_release(lake, "v1")
    place = tmp_path / "lake" / "releases" / "v1"
    assert pq.read_table(place / "library_models.parquet").column("license").to_pylist() == [row.license for row in contents.models]
    backup(lake, tmp_path / "backup")
    restore(tmp_path / "backup", tmp_path / "restored")
    assert contents_of(Lake.open(tmp_path / "restored").snapshot(), "chairs") == contents
    assert inspect(Lake.open(tmp_path / "restored")).errors == ()
    mine, theirs = digests(lake.snapshot()), digests(Lake.open(tmp_path / "restored").snapshot())
    assert {name: mine[name] for name in STAGE.writes} == {name: theirs[name] for name in STAGE.writes}
