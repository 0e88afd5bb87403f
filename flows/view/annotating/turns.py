"""Who waits for what is computed: a few at a time, and nothing that nobody waits for any more."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import Request

from flows.view.annotating.requests import Refusal

AT_ONCE = 2
"""Figures and settlings that are computed at a time."""


class Turns:
    """Turns at computing; of what is asked for again while it waits only the newest gets one."""

    def __init__(self, most: int = AT_ONCE) -> None:
        self._turns = CapacityLimiter(most)
        self._newest: dict[Hashable, object] = {}

    @property
    def waiting(self) -> int:
        """How many wait for their turn."""
        return self._turns.statistics().tasks_waiting

    async def take(self, request: Request, subject: Hashable, compute: Callable[..., Any], *arguments: Any) -> Any:
        """What is computed, in a thread, once it is its turn. `subject`: what is asked for, by whom.

        Raises:
            Refusal: the same was asked for again meanwhile, or who asked went away.
        """
        own = self._newest[subject] = object()
        try:
            async with self._turns:
                if self._newest.get(subject) is not own:
                    raise Refusal(409, "it was asked for again meanwhile")
                if await request.is_disconnected():
                    raise Refusal(409, "who asked went away")
                return await run_sync(compute, *arguments)
        finally:
            if self._newest.get(subject) is own:
                del self._newest[subject]
