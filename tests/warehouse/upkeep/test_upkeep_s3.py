"""Upkeep of lakes in an S3-compatible store (moto's server): the same code, the same result as in a folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.warehouse.test_lake_s3 import bucket
from tests.warehouse.upkeep.test_erasure import HOME, fill, rows_of_others
from tests.whole_scenes import stage_whole_scene
from warehouse.lake import Lake
from warehouse.tables.digest import digests
from warehouse.upkeep.backup import backup, restore
from warehouse.upkeep.compaction import compact
from warehouse.upkeep.erasure import erase
from warehouse.upkeep.inspection import inspect
from warehouse.upkeep.vacuum import vacuum

pytestmark = [pytest.mark.whole, pytest.mark.s3, pytest.mark.slow, pytest.mark.timeout(1200)]

__all__ = ["bucket"]


def test_upkeep_in_a_store_is_that_in_a_folder(bucket: str, tmp_path: Path) -> None:
    lakes = [Lake.open(f"s3://{bucket}/upkeep/lake"), Lake.open(tmp_path / "lake")]
    for lake in lakes:
        fill(lake, release=False)
        before = rows_of_others(lake)
        assert [str(finding) for finding in inspect(lake).findings] == []
        assert compact(lake).tables
        assert erase(lake, HOME, dry_run=True).rows["scenes"] == 1
        done = erase(lake, HOME)
        assert done.proof is not None
        assert done.proof.hits == ()
        assert done.proof.files > 50
        # After it: a vacuum leaves young blobs that no row names any more, and nobody knows then whose they are.
        assert vacuum(lake, days=0, dry_run=True).snapshots == (3,)
        assert vacuum(lake, days=0).snapshots == (3,)
        assert {**rows_of_others(lake), "stage_runs": []} == {**before, "stage_runs": []}
        assert [str(finding) for finding in inspect(lake).findings] == []
    assert {**digests(lakes[0].snapshot()), "stage_runs": ""} == {**digests(lakes[1].snapshot()), "stage_runs": ""}
    assert sorted(lakes[0].blobs) == sorted(lakes[1].blobs)


def test_backups_between_folders_and_stores(bucket: str, tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    fill(lake)
    there = f"s3://{bucket}/backups/one"
    done = backup(lake, there)
    assert done.copied_files == done.files
    stage_whole_scene(lake, HOME, "newer", at=60)
    lake.commit()
    again = backup(lake, there)
    assert again.copied_files < done.files / 2
    for address in (f"s3://{bucket}/restored/lake", str(tmp_path / "restored")):
        restore(there, address)
        restored = Lake.open(address)
        for row in lake.snapshot().snapshots:
            assert digests(restored.snapshot(row.snapshot_id)) == digests(lake.snapshot(row.snapshot_id))
        assert [str(finding) for finding in inspect(restored).findings] == []


def test_releases_in_a_store_forget_a_scene(bucket: str) -> None:
    lake = Lake.open(f"s3://{bucket}/forgetful/lake")
    fill(lake)
    done = erase(lake, HOME)
    assert done.releases == ("v1",)
    assert done.proof is not None
    assert done.proof.hits == ()
    assert [str(finding) for finding in inspect(lake).findings] == []
