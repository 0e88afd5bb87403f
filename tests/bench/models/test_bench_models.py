"""The benchmark of models of others: what its figures and goals say, and a small one of it."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from bench.models import replies
from bench.models.lifting import LiftingFigures
from bench.models.report import ModelsBench, lifting_goals, retrieval_goals, retrieval_rows, run_models_bench
from bench.models.retrieval import RetrievalFigures, RetrievalShares
from bench.models.tables import print_models
from flows.commands.bench import command
from schemas.errors import InputError

WELL = RetrievalShares(0.9, 1.0, 0.8, 0.95, 0.9, 0.7)
LOOKED_UP = RetrievalFigures(40, 439, WELL, np.full(40, 0.02))


def lifted(method: Any, touching: bool, matched: int, word: Any = "desk") -> LiftingFigures:
    return LiftingFigures(word, touching, method, 2, 100, 100, matched, 4.0)


def met(goals: list[dict[str, Any]]) -> dict[str, bool]:
    return {row["goal"]: row["met"] for row in goals}


def test_shares_are_of_desks_and_shelves_together() -> None:
    rows = [lifted("classical", False, 90), lifted("classical", False, 100, "bookshelf"), lifted("classical", True, 75)]
    rows += [lifted(method, touching, 100) for method in ("true masks", "corrupted masks", "stand-ins") for touching in (False, True)]
    goals = lifting_goals(rows)
    assert {row["found"] for row in goals if row["goal"].startswith("classical, apart")} == {0.95}
    assert all(met(goals).values())
    assert not met(lifting_goals([*rows, lifted("true masks", True, 99)]))["true masks: recall"]
    assert not met(lifting_goals([*rows, lifted("classical", True, 60)]))["classical, touching: precision"]


def test_retrieval_is_held_against_shares_and_a_time() -> None:
    assert all(met(retrieval_goals(LOOKED_UP)).values())
    for change, goal in (
        ({"shares": dataclasses.replace(WELL, in_ten_unnamed=0.8)}, "among ten, category unknown"),
        ({"seconds": np.full(40, 0.06)}, "seconds of a query among 10,000 models, of 20 the slowest"),
    ):
        missed = [name for name, is_met in met(retrieval_goals(dataclasses.replace(LOOKED_UP, **change))).items() if not is_met]
        assert missed == [goal]
    (row,) = retrieval_rows(LOOKED_UP)
    assert (row["first"], row["models"], row["median_seconds"]) == (0.9, 439, 0.02)


def test_a_reader_that_accepts_what_was_not_meant_misses_its_goal(monkeypatch: pytest.MonkeyPatch) -> None:
    assert all(met(replies.reply_report(200, 0)["goals"]).values())
    right = replies.attributes_of
    monkeypatch.setattr(replies, "attributes_of", lambda reply, size: dataclasses.replace(right(reply, size), mass_kg=1.0))
    assert not met(replies.reply_report(200, 0)["goals"])["wrong values that were accepted"]


def test_a_reader_that_refuses_all_misses_its_goal(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(reply: str, *more: Any) -> Any:
        raise replies.UnreadableReply("no")

    monkeypatch.setattr(replies, "attributes_of", refuse)
    assert not met(replies.reply_report(200, 0)["goals"])["share of replies that were read"]


def test_without_models_nothing_is_begun(tmp_path: Path) -> None:
    advances: list[str] = []
    with pytest.raises(InputError, match="--realdata"):
        run_models_bench(ModelsBench(realdata=tmp_path), advances.append)
    assert advances == []


def test_the_command_prints_one_object_or_tables() -> None:
    done = CliRunner().invoke(command, ["models", "--parts", "replies", "--json"])
    assert done.exit_code == 0
    report = json.loads(done.stdout)
    assert [row["wrong"] for row in report["parts"]["replies"]["rows"]] == [0, 0, 0]
    report["parts"]["retrieval"] = {"rows": retrieval_rows(LOOKED_UP)}
    report["parts"]["lifting"] = {"rows": [{**dataclasses.asdict(lifted("classical", True, 75)), "precision": 0.75, "recall": 0.75}]}
    out = io.StringIO()
    print_models(report, Console(file=out, width=200))
    for text in ("corrupted replies", "touching", "75.0 %", "90.0 %", "20.0 ms", "wrong values that were accepted"):
        assert text in out.getvalue()
