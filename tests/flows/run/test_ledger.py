"""The ledger of a run: nothing twice, nothing beyond the budget, and a run that is replayed without a network."""

from __future__ import annotations

import dataclasses
import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from flows.run.ledger import SPENT, BudgetSpent, CallRules, LakeLedger, NotRecorded
from flows.run.patience import is_away
from schemas.calls import ModelCall
from schemas.errors import InputError
from tasks.calls.asking import Conversation, ask
from tasks.calls.endpoint import EndpointSettings, check_endpoint
from tasks.calls.exchange import EndpointAway
from tasks.calls.prompts import Prompt
from tasks.stage import Context
from tests.tasks.calls.servers import Server, refuses, says, server
from warehouse.lake import Lake

__all__ = ["server"]

SCHEMA = {"type": "object"}
PROMPT = Prompt("test", "say {word}")


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return Lake.open(tmp_path / "lake")


def settings(server: Server, **more: float) -> EndpointSettings:
    return EndpointSettings(server.url, "seer-1", attempts=2, pause_seconds=0.0, **more)  # type: ignore[arg-type]


def context(lake: Lake, **rules: object) -> Context:
    return Context("demo/a_00", "captions", 0, lake.blobs, ledger=LakeLedger(lake, CallRules(**{"run": "one", **rules})))  # type: ignore[arg-type]


def about(word: str) -> Conversation:
    return Conversation(PROMPT, [{"role": "user", "content": word}], SCHEMA, "0007")


def asker(lake: Lake, server: Server, **rules: object) -> Callable[[str], str]:
    known = context(lake, **rules)
    return lambda word: ask(known, settings(server, prompt_usd_per_million=1e6), about(word), "captions.provider").text


def test_nothing_that_was_answered_is_asked_again_by_anybody(lake: Lake, server: Server) -> None:
    server.answers = [says("yes")]
    assert asker(lake, server)("a") == "yes"
    assert asker(lake, server)("a") == asker(Lake.open(lake.address), server, run="two")("a") == "yes"
    lake.commit()
    assert asker(lake, server)("a") == "yes"
    travelled = pickle.loads(pickle.dumps(context(lake)))
    assert ask(travelled, settings(server), about("a"), "x").text == "yes"
    assert len(server.requests) == 1
    (row,) = lake.snapshot().rows(ModelCall)
    assert (row.scene_id, row.stage, row.instance_id, row.run, row.outcome) == ("demo/a_00", "captions", "0007", "one", "answered")
    sent = json.loads(lake.blobs[row.request_blob])
    assert sent == {"messages": [{"role": "user", "content": "a"}], "schema": SCHEMA}


def test_a_call_that_failed_is_recorded_and_asked_again(lake: Lake, server: Server) -> None:
    server.answers = [refuses(503), refuses(503), says("yes")]
    with pytest.raises(EndpointAway):
        asker(lake, server)("a")
    (failed,) = lake.calls.all().values()
    assert (failed.outcome, failed.attempts, failed.reply_blob) == ("away", 2, None)
    assert asker(lake, server)("a") == "yes"
    (answered,) = lake.calls.all().values()
    assert (answered.outcome, answered.call_id, answered.attempts) == ("answered", failed.call_id, 3)
    assert lake.storage.names("calls", f"{failed.call_id}@") == [], "nothing is under way any more"


def answered(cost_tokens: int) -> Callable[[dict[str, object]], tuple[int, object, dict[str, str]]]:
    usage = {"prompt_tokens": cost_tokens, "completion_tokens": 0}
    return lambda body: (200, {"choices": [{"message": {"content": "yes"}}], "usage": usage}, {})


BUDGETS = [({"most_calls": 3}, 3), ({"most_calls": 0}, 0), ({"budget_usd": 5.0}, 3), ({"budget_usd": 0.0}, 0)]


@pytest.mark.parametrize(("rules", "made"), BUDGETS)
@pytest.mark.parametrize("commits", [False, True])
def test_a_budget_holds_over_all_workers_and_commits(
    lake: Lake, server: Server, rules: dict[str, object], made: int, commits: bool
) -> None:
    server.answers = [answered(2)]
    words = "abcdefg"
    for word in words[:made]:
        assert asker(Lake.open(lake.address), server, **rules)(word) == "yes"  # another worker each time
        if commits:
            lake.commit()
    with pytest.raises(BudgetSpent, match=SPENT) as spent:
        asker(Lake.open(lake.address), server, **rules)(words[made])
    assert made == len(server.requests)
    assert is_away(spent.value), "the next run goes on"
    for word in words[:made]:
        assert asker(lake, server, **rules)(word) == "yes", "what was answered costs nothing"
    next_run = {**rules, "most_calls": 1} if "most_calls" in rules else {"budget_usd": 1.0}
    assert asker(lake, server, run="two", **next_run)("g") == "yes"


def test_a_run_is_replayed_without_a_network(lake: Lake, server: Server, tmp_path: Path) -> None:
    server.answers = [says("yes"), says("no")]
    for word in "ab":
        asker(lake, server)(word)
    lake.commit()
    server.requests.clear()
    again = Lake.open(tmp_path / "again")
    replaying = asker(again, server, replay=lake.address)
    assert [replaying(word) for word in "ab"] == ["yes", "no"]
    with pytest.raises(NotRecorded, match="has no reply"):
        replaying("c")
    assert not server.requests
    again.commit()
    kept, first = again.snapshot().rows(ModelCall), lake.snapshot().rows(ModelCall)
    assert kept == first, "rows and all that they name go along"
    assert all(row.reply_blob in again.blobs and row.request_blob in again.blobs for row in kept)
    assert asker(lake, server, replay=lake.address)("a") == "yes"


def test_what_failed_fails_again_when_it_is_replayed(lake: Lake, server: Server, tmp_path: Path) -> None:
    """So that what stood in for it stands in again."""
    server.answers = [refuses(503), refuses(503), refuses(422)]
    with pytest.raises(EndpointAway):
        asker(lake, server)("a")
    with pytest.raises(InputError, match="HTTP 422"):
        asker(lake, server)("b")
    lake.commit()
    server.requests.clear()
    again = Lake.open(tmp_path / "again")
    replaying = asker(again, server, replay=lake.address)
    for _ in range(2):
        with pytest.raises(EndpointAway, match="HTTP 503"):
            replaying("a")
        with pytest.raises(InputError, match="HTTP 422"):
            replaying("b")
    assert not server.requests
    again.commit()
    assert again.snapshot().rows(ModelCall) == lake.snapshot().rows(ModelCall)


def test_replaying_needs_no_key(lake: Lake, server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    server.answers = [says("yes")]
    monkeypatch.setenv("SEER_KEY", "secret-0123456789")
    told = dataclasses.replace(settings(server), key_variable="SEER_KEY")
    assert ask(context(lake), told, about("a"), "captions.provider").text == "yes"
    monkeypatch.delenv("SEER_KEY")
    check_endpoint(told, "captions.provider")
    assert ask(context(lake), told, about("a"), "captions.provider").text == "yes"
    with pytest.raises(InputError, match="SEER_KEY holds no key"):
        ask(context(lake), told, about("b"), "captions.provider")
    assert len(server.requests) == 1


def test_a_lake_to_replay_that_is_not_there_is_one_line_before_the_run_begins(tmp_path: Path) -> None:
    from click.testing import CliRunner

    from flows.commands.run import command

    (tmp_path / "scans").mkdir()
    result = CliRunner().invoke(
        command, ["--scans", str(tmp_path / "scans"), "--lake", str(tmp_path / "lake"), "--replay", str(tmp_path / "typo")]
    )
    assert isinstance(result.exception, InputError)
    assert "typo: --replay: there is no lake" in str(result.exception)


def test_a_call_whose_process_died_is_counted_by_the_next(lake: Lake, server: Server) -> None:
    server.answers = [says("yes")]
    known = context(lake)
    call_id = next(iter(_ids(known, server)))
    script = f"from warehouse.lake import Lake; Lake.open({lake.address!r}).calls.mark({call_id!r})"
    subprocess.run([sys.executable, "-c", script], check=True)
    asker(lake, server)("a")
    (row,) = lake.calls.all().values()
    assert (row.call_id, row.lost) == (call_id, 1)
    assert lake.storage.names("calls", f"{call_id}@") == []


def _ids(known: Context, server: Server) -> list[str]:
    """Ids of the calls that asking `a` makes."""
    from tasks.calls.ledger import Recollection

    seen = Recollection()
    ask(Context(known.scene_id, known.stage, 0, {}, ledger=seen), settings(server, prompt_usd_per_million=1e6), about("a"), "x")
    server.requests.clear()
    return list(seen.calls)


def test_every_request_keeps_the_limit(lake: Lake, server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []
    monkeypatch.setattr(LakeLedger, "request", lambda self: taken.append(1))
    server.answers = [refuses(503), says("yes")]
    asker(lake, server)("a")
    assert len(taken) == len(server.requests) == 2


def test_when_it_was_asked_is_said(lake: Lake, server: Server) -> None:
    server.answers = [says("yes")]
    before = datetime.now(UTC)
    asker(lake, server)("a")
    (row,) = lake.calls.all().values()
    assert before <= row.asked_at <= datetime.now(UTC)
