"""The lake in an S3-compatible store (moto's server): the same code, the same result as in a folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas.calls import ModelCall
from schemas.captions import Caption
from schemas.errors import InputError
from tests.conftest import REPOSITORY
from tests.samples import fingerprint, sample, stage_run
from tests.services import environment_of, s3_server
from tests.warehouse.lake_load import scene_id, stage_scene
from warehouse.lake import Lake
from warehouse.questions.sql import query
from warehouse.sharing.lease import PATH, Lease, LeaseError
from warehouse.storage.files import storage_at
from warehouse.tables.digest import digests

pytestmark = [pytest.mark.whole, pytest.mark.s3]


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    """A bucket on a server of its own, with the environment that leads to it."""
    with s3_server() as s3, environment_of(s3):
        s3.make_bucket("lakes")
        yield "lakes"


def test_same_rows_and_blobs_as_in_a_folder(bucket: str, tmp_path: Path) -> None:
    found = []
    for address in (f"s3://{bucket}/same/lake", str(tmp_path / "lake")):
        lake = Lake.open(address)
        assert lake.history() == {}
        assert lake.snapshot().rows(Caption) == []
        for number in range(3):
            stage_scene(lake, number, "old", at=number)
        lake.commit("first")
        assert len(lake.history()) == 9
        stage_scene(lake, 0, "new", at=10)
        lake.stage_rows(stage_run(scene_id(1), "capture", fingerprint("changed"), at=12))
        assert lake.staged_rows("captions", scene_id(0), fingerprint(scene_id(0), "new", "captions"))
        lake.commit("second")
        lake.sweep()
        reader = lake.snapshot()
        sql = "SELECT scene_id, sentence, count(*) AS n FROM captions GROUP BY ALL ORDER BY ALL"
        counted = [{"scene_id": scene_id(0), "sentence": "new", "n": 5}, {"scene_id": scene_id(2), "sentence": "old", "n": 5}]
        assert query(reader, sql).to_pylist() == counted
        assert len(lake.snapshot(1).rows(Caption)) == 15
        assert lake.storage.names("staged") == []
        found.append([digests(reader), digests(lake.snapshot(1)), sorted(lake.blobs)])
    assert found[0] == found[1]


@pytest.mark.slow
def test_other_objects_are_out_of_reach_of_sql(bucket: str) -> None:
    lake = Lake.open(f"s3://{bucket}/guard/lake")
    stage_scene(lake, 1, "x", at=0)
    lake.commit()
    own = f"s3://{bucket}/guard/lake/{lake.snapshot().files('captions')[0]}"
    assert query(lake.snapshot(), f"SELECT * FROM read_parquet('{own}')").num_rows == 5
    other = Lake.open(f"s3://{bucket}/guard/other")
    stage_scene(other, 1, "x", at=0)
    other.commit()
    theirs = f"s3://{bucket}/guard/other/{other.snapshot().files('captions')[0]}"
    for path in (theirs, "/etc/passwd"):
        with pytest.raises(InputError):
            query(lake.snapshot(), f"SELECT * FROM read_parquet('{path}')")


def test_conditional_puts(bucket: str) -> None:
    storage = storage_at(f"s3://{bucket}/puts")
    assert storage.create("a", b"1")
    assert not storage.create("a", b"2")
    found = storage.read_tagged("a")
    assert found is not None
    assert found[0] == b"1"
    assert storage.swap("a", b"3", found[1])
    assert not storage.swap("a", b"4", found[1])
    assert not storage.swap("a", None, found[1])
    assert storage.read("a") == b"3"
    assert storage.swap("a", None, storage.read_tagged("a")[1])  # type: ignore[index]
    assert not storage.exists("a")
    assert storage.read_tagged("a") is None
    assert not storage.swap("a", b"5", found[1])
    with pytest.raises(FileNotFoundError):
        storage.read("a")
    storage.remove("a")
    storage.write("f/x1", b"1")
    storage.write("f/x2", b"22")
    storage.write("f/g/y", b"333")
    assert [(entry.path, entry.size) for entry in storage.entries("f")] == [("f/x1", 1), ("f/x2", 2)]
    assert storage.names("f") == ["x1", "x2"]
    assert storage.names("f", "x2") == ["x2"]
    assert storage.folders("f") == ["g"]
    assert storage.folders("") == ["f"]
    assert storage.names("missing") == storage.names("missing", "x") == storage.folders("missing") == []
    assert storage.local_path("a") is None


def test_lease(bucket: str) -> None:
    storage = storage_at(f"s3://{bucket}/lease")
    with Lease(storage, life=6.0) as lease:
        with pytest.raises(LeaseError), Lease(storage, timeout=0.3):
            pass
        first = json.loads(storage.read(PATH))["expires"]
        while json.loads(storage.read(PATH))["expires"] <= first:  # until it is renewed
            time.sleep(0.05)
        lease.check()
    assert not storage.exists(PATH)
    storage.create(PATH, json.dumps({"token": "ffffffff-1-2-3", "host": "gone", "expires": time.time() - 1, "life": 60}).encode())
    with Lease(storage, timeout=5):
        pass


def test_two_processes_at_once(bucket: str) -> None:
    address = f"s3://{bucket}/two/lake"
    command = [sys.executable, "-m", "tests.warehouse.lake_load", "writer", address]
    processes = [subprocess.Popen([*command, str(first), "3", "1"], cwd=REPOSITORY, env=dict(os.environ)) for first in (0, 3)]
    assert [process.wait(timeout=180) for process in processes] == [0, 0]
    lake = Lake.open(address)
    assert len(lake.snapshot().rows(Caption)) == 30
    assert lake.storage.names("staged") == []
    assert {state.done is not None for state in lake.history().values()} == {True}


def test_address_without_prefix_is_refused() -> None:
    for wrong in ("s3://bucket", "s3://", "s3://bucket/"):
        with pytest.raises(InputError, match="needs a bucket and a prefix"):
            Lake.open(wrong)


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "testing")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "testing")
    for module, package in (("obstore", "obstore"), ("botocore.session", "botocore")):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, module, None)
            with pytest.raises(InputError, match=rf"need the package {package}; pip install {package}$"):
                Lake.open("s3://bucket/lake")


def test_calls_are_recorded_once_and_committed(bucket: str) -> None:
    lake = Lake.open(f"s3://{bucket}/calls/lake")
    replies = [lake.blobs.put(text, "txt") for text in (b"first", b"second")]
    rows = [
        sample(
            ModelCall, call_id=fingerprint("one"), scene_id=scene_id(0), request_blob=replies[0], reply_blob=reply, outcome="answered",
            problem=None,
        )
        for reply in replies
    ]  # fmt: skip
    mark = lake.calls.mark(rows[0].call_id)
    assert [Lake.open(lake.address).calls.create(row) for row in rows] == [True, False]
    assert Lake.open(lake.address).call(rows[0].call_id) == rows[0]
    lake.calls.unmark(mark)
    assert lake.commit("calls") is not None
    assert lake.snapshot().rows(ModelCall) == [rows[0]]
    assert lake.storage.names("calls") == []
    assert lake.call(rows[0].call_id) == rows[0]
