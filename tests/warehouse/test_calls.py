"""Calls in the lake: kept the moment that they are answered, committed once, and the first reply stays."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from schemas.calls import ModelCall
from schemas.errors import InputError
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.questions.sql import query
from warehouse.tables.calls import FOLDER, FORGOTTEN_SECONDS
from warehouse.upkeep.backup import backup, restore
from warehouse.upkeep.erasure import erase
from warehouse.upkeep.inspection import inspect
from warehouse.upkeep.vacuum import vacuum

A, B = "demo/a_00", "demo/b_00"


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return Lake.open(tmp_path / "lake")


def call(lake: Lake, name: str, reply: str | None = "yes", **values: Any) -> ModelCall:
    request, answer = lake.blobs.put(f"asks {name}".encode(), "json"), lake.blobs.put(reply.encode(), "txt") if reply is not None else None
    facts = {"outcome": "answered" if reply is not None else "away", "scene_id": A, "stage": "captions", "problem": None, "run": "one"}
    return sample(ModelCall, call_id=fingerprint(name), request_blob=request, reply_blob=answer, **{**facts, **values})


def with_scene(lake: Lake, scene: str) -> None:
    from tests.warehouse.test_lake import walked

    walked(lake, scene)


def rows(lake: Lake) -> list[ModelCall]:
    return lake.snapshot().rows(ModelCall)


def test_a_call_is_there_before_and_after_a_commit(lake: Lake) -> None:
    made = call(lake, "one")
    assert lake.call(made.call_id) is None
    assert lake.calls.create(made)
    assert lake.call(made.call_id) == made
    assert Lake.open(lake.address).call(made.call_id) == made
    assert rows(lake) == []
    assert lake.commit("calls") is not None
    assert rows(lake) == [made]
    assert lake.call(made.call_id) == made
    assert lake.storage.names(FOLDER) == []
    assert lake.commit("again") is None


def test_the_first_reply_stays_and_takes_the_place_of_a_failure(lake: Lake) -> None:
    failed = call(lake, "one", None, attempts=4, lost=1)
    first, second = call(lake, "one", "first", attempts=1, lost=0), call(lake, "one", "second", attempts=1, lost=0)
    assert lake.calls.create(failed)
    assert lake.calls.create(first), "a failure is no reply"
    assert not lake.calls.create(second)
    assert not lake.calls.create(failed)
    assert lake.call(first.call_id) == first
    lake.commit()
    (row,) = rows(lake)
    assert row == dataclasses.replace(first, attempts=9, lost=2), "requests of all tries are counted"
    assert lake.calls.create(second), "whoever looks into the table sees that there is one"
    assert lake.call(first.call_id) == row
    lake.commit()
    assert rows(lake) == [row]
    assert lake.storage.names(FOLDER) == []


def test_a_reply_that_comes_while_a_commit_looks_at_a_failure_is_kept(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file is removed by its name, and no file ever changes: what came later has another name."""
    failed, reply = call(lake, "one", None), call(lake, "one", "reply")
    lake.calls.create(failed)
    remove = type(lake.calls).remove
    other = Lake.open(lake.address)
    with monkeypatch.context() as patched:
        patched.setattr(type(lake.calls), "remove", lambda self, paths: (other.calls.create(reply), remove(self, paths)))
        lake.commit()
    fresh = Lake.open(lake.address)
    assert fresh.call(reply.call_id) == reply
    fresh.commit()
    assert [row.reply_blob for row in rows(fresh)] == [reply.reply_blob]


def test_a_failure_that_was_committed_is_replaced_by_a_reply(lake: Lake) -> None:
    early, late = datetime(2026, 1, 1, tzinfo=UTC), datetime(2026, 1, 2, tzinfo=UTC)
    failed = call(lake, "one", None, attempts=4, lost=0, asked_at=early)
    first = call(lake, "one", "first", attempts=1, lost=1, asked_at=late)
    lake.calls.create(failed)
    lake.commit()
    assert rows(lake) == [failed]
    lake.calls.create(first)
    assert lake.call(first.call_id) == first
    lake.commit()
    assert rows(lake) == [dataclasses.replace(first, attempts=5, lost=1)]


def test_of_many_at_once_one_is_first(lake: Lake) -> None:
    made = [call(lake, "one", f"reply {number}") for number in range(12)]
    barrier, won = threading.Barrier(12), []

    def create(row: ModelCall) -> None:
        barrier.wait()
        if Lake.open(lake.address).calls.create(row):
            won.append(row)

    threads = [threading.Thread(target=create, args=(row,)) for row in made]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(won) == 1
    assert lake.call(won[0].call_id) == won[0]


def test_calls_go_with_the_commit_of_any_scene_but_are_no_reason_for_one(lake: Lake) -> None:
    made = call(lake, "one")
    lake.calls.create(made)
    assert lake.commit(scenes=[]) is None
    assert lake.commit(scenes=[B]) is None
    with_scene(lake, B)
    assert lake.commit(scenes=[B]) is not None
    assert rows(lake) == [made]


def test_a_commit_that_died_after_its_snapshot_leaves_nothing_twice(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    made = call(lake, "one")
    lake.calls.create(made)
    with monkeypatch.context() as patched:
        patched.setattr(type(lake.calls), "remove", lambda self, paths: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            lake.commit()
    fresh = Lake.open(lake.address)
    fresh.commit()
    assert lake.storage.names(FOLDER) == []
    assert rows(fresh) == [made]


def test_calls_under_way_count_as_lost_when_their_process_is_dead(lake: Lake) -> None:
    made = call(lake, "one")
    own = lake.calls.mark(made.call_id)
    assert lake.calls.lost(made.call_id) == []
    script = f"from warehouse.lake import Lake; print(Lake.open({lake.address!r}).calls.mark({made.call_id!r}))"
    left = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.strip()
    assert lake.calls.lost(made.call_id) == [left]
    lake.calls.unmark(own)
    lake.calls.sweep()
    assert lake.storage.names(FOLDER) == [left.rpartition("/")[2]], "it is counted by whoever asks again"


def test_marks_that_nobody_asks_for_go_in_time(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    from warehouse.tables import calls as module

    mark = lake.calls.mark(fingerprint("one"))
    monkeypatch.setattr(module, "_is_left", lambda entry: True)
    lake.calls.sweep()
    assert lake.storage.exists(mark)
    now = module.time.time()
    monkeypatch.setattr(module.time, "time", lambda: now + FORGOTTEN_SECONDS + 60)
    lake.calls.sweep()
    assert not lake.storage.exists(mark)


def test_vacuum_and_doctor_know_the_blobs_of_calls(lake: Lake) -> None:
    failed = dataclasses.replace(stage_run(A, "captions", fingerprint("x")), outcome="failed", error="x", error_kind="input")
    lake.stage_rows(failed, {})
    lake.commit()
    made = call(lake, "one")
    lake.calls.create(made)
    for path in (Path(lake.address) / "blobs").rglob("*.*"):
        os.utime(path, (0, 0))
    vacuum(lake, days=0)
    assert made.reply_blob in Lake.open(lake.address).blobs
    assert inspect(lake).findings == ()
    lake.commit()
    assert inspect(lake).findings == ()
    (Path(lake.address) / FOLDER / "notes.txt").parent.mkdir(exist_ok=True)
    (Path(lake.address) / FOLDER / "notes.txt").write_text("x")
    (Path(lake.address) / FOLDER / f"{fingerprint('two')}.parquet").write_bytes(b"PAR1 not quite")
    found = {(fault.kind, fault.file) for fault in inspect(lake).findings}
    assert found == {("foreign file", f"{FOLDER}/notes.txt"), ("recorded call", f"{FOLDER}/{fingerprint('two')}.parquet")}
    with pytest.raises(InputError, match="asked again"):
        lake.commit()


def test_an_erased_scene_takes_its_calls_along(lake: Lake) -> None:
    with_scene(lake, A)
    with_scene(lake, B)
    kept, gone, pending = call(lake, "kept", scene_id=B), call(lake, "gone"), call(lake, "pending", "only here")
    for each in (kept, gone):
        lake.calls.create(each)
    lake.commit()
    lake.calls.create(pending)
    erased = erase(lake, A)
    assert erased.proof is not None
    assert not erased.proof.hits
    assert rows(lake) == [kept]
    assert lake.call(gone.call_id) is None
    assert lake.call(pending.call_id) is None
    fresh = Lake.open(lake.address)
    assert kept.reply_blob in fresh.blobs, "both were told `yes`"
    assert gone.request_blob not in fresh.blobs
    assert pending.reply_blob not in fresh.blobs


def test_a_restored_backup_has_the_replies(lake: Lake, tmp_path: Path) -> None:
    made = call(lake, "one")
    lake.calls.create(made)
    lake.commit()
    backup(lake, tmp_path / "backup")
    restore(tmp_path / "backup", tmp_path / "restored")
    again = Lake.open(tmp_path / "restored")
    assert again.call(made.call_id) == made
    assert made.reply_blob is not None
    assert again.blobs[made.reply_blob] == b"yes"


def test_views_tell_costs_and_times(lake: Lake) -> None:
    common = {"model": "seer-1", "model_version": "", "prompt": "appearance", "prompt_version": "abc", "attempts": 1, "lost": 0}
    for number, seconds in enumerate((1.0, 2.0, 3.0)):
        answered = {"prompt_tokens": 100, "reply_tokens": 10, "cost_usd": 0.5, "seconds": seconds}
        lake.calls.create(dataclasses.replace(call(lake, f"{number}", scene_id=A if number else B), **common, **answered))
    lost = {"prompt_tokens": None, "reply_tokens": None, "cost_usd": 0.0, "seconds": 9.0}
    lake.calls.create(dataclasses.replace(call(lake, "away", None, scene_id=B), **{**common, "attempts": 4, "lost": 2}, **lost))
    lake.commit()
    ask = lake.snapshot()
    (cost,) = query(
        ask, "SELECT calls, answered, away, requests, lost, prompt_tokens, cost_usd, cost_usd_per_answer FROM model_call_costs"
    ).to_pylist()
    assert cost == {
        "calls": 4, "answered": 3, "away": 1, "requests": 7, "lost": 2, "prompt_tokens": 300, "cost_usd": 1.5, "cost_usd_per_answer": 0.5,
    }  # fmt: skip
    (times,) = query(ask, "SELECT calls, median_seconds, slowest_seconds, reply_tokens_per_second FROM model_call_latency").to_pylist()
    assert times == {"calls": 3, "median_seconds": 2.0, "slowest_seconds": 3.0, "reply_tokens_per_second": 5.0}
    by_scene = query(ask, "SELECT scene_id, calls, unanswered, cost_usd FROM model_call_costs_by_scene ORDER BY scene_id").to_pylist()
    assert by_scene == [
        {"scene_id": A, "calls": 2, "unanswered": 0, "cost_usd": 1.0}, {"scene_id": B, "calls": 2, "unanswered": 1, "cost_usd": 0.5},
    ]  # fmt: skip


def test_a_run_and_its_calls_may_be_committed_together(lake: Lake) -> None:
    made = call(lake, "one")
    lake.calls.create(made)
    failed = dataclasses.replace(stage_run(A, "captions", fingerprint("x")), outcome="failed", error="x", error_kind="input")
    lake.stage_rows(failed, {})
    assert lake.commit(scenes=[A]) is not None
    assert rows(lake) == [made]
