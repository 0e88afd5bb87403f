"""Finished datasets in a lake in an S3-compatible store (moto's server): the same code, the same result as in a folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows.inputs.ingestion import import_dataset
from tests.flows.inputs.metascenes_release import write_release
from tests.replicas import furnished
from tests.warehouse.test_lake_s3 import bucket
from warehouse.lake import Lake
from warehouse.tables.digest import digests

pytestmark = [pytest.mark.whole, pytest.mark.s3]

__all__ = ["bucket"]


def test_a_lake_in_a_bucket_gets_the_same_rows_and_blobs(bucket: str, tmp_path: Path) -> None:
    write_release(tmp_path / "release", {"scene0000_00": furnished()[3:5]})
    found = []
    for address in (f"s3://{bucket}/imported/lake", str(tmp_path / "lake")):
        lake = Lake.open(address)
        for action in ("import", "reuse"):
            assert [one.action for one in import_dataset(lake, "metascenes", tmp_path / "release", "other").scenes] == [action]
        found.append(digests(lake.snapshot()))
    assert found[0] == found[1]
