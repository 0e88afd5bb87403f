"""Turns at computing: a few at a time, the newest of what is asked for again, and nothing for who went away."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest
from fastapi import Request

from flows.view.annotating.requests import Refusal
from flows.view.annotating.turns import Turns


def asked(is_gone: bool = False) -> Request:
    """A request whose body was read; of somebody who waits, or has gone."""

    async def receive() -> Any:
        if not is_gone:
            await asyncio.Event().wait()
        return {"type": "http.disconnect"}

    return Request({"type": "http", "method": "POST", "headers": []}, receive)


def test_only_what_somebody_waits_for_is_computed() -> None:
    begun: list[str] = []
    go_on = threading.Event()

    def compute(name: str) -> str:
        begun.append(name)
        assert go_on.wait(60)
        return name

    async def whole() -> list[Any]:
        turns = Turns(2)
        running = [asyncio.create_task(turns.take(asked(), name, compute, name)) for name in ("a", "b")]
        while len(begun) < 2:
            await asyncio.sleep(0)
        waiting = []
        for subject, name, is_gone in (
            ("c", "c1", False), ("c", "c2", False), ("d", "d1", True), ("a", "a2", False), ("c", "c3", False)
        ):  # fmt: skip
            waiting.append(asyncio.create_task(turns.take(asked(is_gone), subject, compute, name)))
            while turns.waiting < len(waiting):
                await asyncio.sleep(0)
        assert sorted(begun) == ["a", "b"], "two at a time"
        go_on.set()
        return await asyncio.gather(*running, *waiting, return_exceptions=True)

    *done, first, second, gone, again, newest = asyncio.run(whole())
    assert (done, again, newest) == (["a", "b"], "a2", "c3")
    assert [refused.document["error"] for refused in (first, second, gone) if isinstance(refused, Refusal)] == [
        "it was asked for again meanwhile", "it was asked for again meanwhile", "who asked went away",
    ]  # fmt: skip
    assert sorted(begun) == ["a", "a2", "b", "c3"]


def test_what_fails_leaves_its_turn() -> None:
    def fail() -> None:
        raise Refusal(400, "no")

    async def whole() -> str:
        turns = Turns(1)
        for _ in range(3):
            with pytest.raises(Refusal, match="no"):
                await turns.take(asked(), "a", fail)
        return str(await turns.take(asked(), "a", lambda: "done"))

    assert asyncio.run(whole()) == "done"
