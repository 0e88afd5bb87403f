"""Releases of a lake in an S3-compatible store."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import duckdb
import pytest

from schemas.runs import Release
from tests.warehouse.lake_load import stage_scene
from tests.warehouse.test_lake_s3 import bucket  # noqa: F401  # a fixture
from warehouse.lake import Lake
from warehouse.questions.sql import query
from warehouse.release import make_release, release_of, releases
from warehouse.release.catalog import attach_release
from warehouse.release.difference import difference
from warehouse.storage.files import storage_at

pytestmark = [pytest.mark.whole, pytest.mark.s3]

for package in ("moto", "obstore", "flask"):
    pytest.importorskip(package)


@pytest.mark.slow
def test_a_release_in_a_bucket_is_the_one_in_a_folder(bucket: str, tmp_path: Path) -> None:  # noqa: F811
    lakes = [Lake.open(f"s3://{bucket}/released"), Lake.open(tmp_path / "lake")]
    for lake in lakes:
        for i in range(2):
            stage_scene(lake, 0, i, at=10 * i)
            stage_scene(lake, 1, "same", at=10 * i + 1)
            lake.commit()
        make_release(lake, "v1", snapshot_id=1)
        make_release(lake, "v2")
    sums = []
    for lake in lakes:
        assert [release.name for release in releases(lake)] == ["v1", "v2"]
        files = {path: lake.storage.read(path) for path in sorted(entry.path for entry in lake.storage.entries("releases/v2"))}
        listed = dict(reversed(line.split("  ")) for line in files["releases/v2/SHA256SUMS"].decode().splitlines())
        assert {f"releases/v2/{name}": value for name, value in listed.items()} == {
            path: hashlib.sha256(data).hexdigest() for path, data in files.items() if not path.endswith(("SHA256SUMS", "release.json"))
        }
        volatile = ("releases.parquet", "snapshots.parquet", "stage_runs.parquet", "README.md", "croissant.json", "v2.duckdb")
        sums.append({name: value for name, value in listed.items() if name not in volatile})
        assert json.loads(files["releases/v2/release.json"])["name"] == "v2"
    assert sums[0] == sums[1]
    remote = lakes[0]
    assert remote.snapshot(1).rows(Release) == [release_of(remote, "v1")]
    assert query(remote.snapshot(), "SELECT name FROM releases ORDER BY name").to_pydict() == {"name": ["v1", "v2"]}
    found = [difference(lake, lake.snapshot(1), lake.snapshot(2)) for lake in lakes]
    assert found[0] == found[1]
    assert found[0].scenes.changed.count == 1
    attach_release(remote, "v2", tmp_path / "v2.duckdb")
    with duckdb.connect() as connection:
        remote.storage.register(connection)
        connection.execute(f"ATTACH '{tmp_path / 'v2.duckdb'}' AS v2 (READ_ONLY)")
        assert connection.sql("SELECT count(*) FROM v2.captions").fetchall() == [(10,)]


def test_large_files_are_put_in_their_place_whole(bucket: str, tmp_path: Path) -> None:  # noqa: F811
    for address in (f"s3://{bucket}/large", tmp_path / "store"):
        storage = storage_at(address)
        data = bytes(range(256)) * 50_000
        with storage.workplace() as folder:
            (folder / "part").write_bytes(data)
            storage.move_in(folder / "part", "deep/er/file")
            assert not (folder / "part").exists()
        assert not folder.exists()
        assert storage.read("deep/er/file") == data
        (tmp_path / "other").write_bytes(b"new")
        storage.move_in(tmp_path / "other", "deep/er/file")
        assert storage.read("deep/er/file") == b"new"
