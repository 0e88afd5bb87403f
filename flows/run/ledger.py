"""The ledger of calls in a lake, as stages see it: with a budget, a rate, and replies of another lake to replay."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator

import pyarrow.compute as pc

from schemas.calls import ModelCall
from schemas.errors import InputError
from schemas.wording import counted
from tasks.calls.exchange import EndpointAway
from tasks.calls.ledger import NoFurtherCall
from warehouse.lake import Lake

SPENT = "the budget of calls is spent"
"""How the error begins by which a run knows that no further scene is worth a try."""


class BudgetSpent(NoFurtherCall):
    """No further call may be made in this run: nobody's fault, and the next run goes on."""


class NotRecorded(NoFurtherCall):
    """A call has no reply in the ledger, and none may be asked for."""


@dataclasses.dataclass(frozen=True)
class CallRules:
    """What a run may ask models for. run: Its name in rows. budget_usd, most_calls: Over all of its workers; None is no bound.

    replay: Address of a lake whose replies stand in for every call, so that nothing is asked; '' where models are asked.
    limit: Global concurrency limit of the Prefect server that every request keeps; '' for none.
    """

    run: str = ""
    budget_usd: float | None = None
    most_calls: int | None = None
    replay: str = ""
    limit: str = ""


FREE = CallRules()
"""Without bounds."""


class LakeLedger:
    """A `tasks.calls.ledger.Ledger`. Can be pickled: it is the lake's address and the rules."""

    def __init__(self, lake: Lake, rules: CallRules) -> None:
        self._lake, self._rules = lake, rules
        self._spent: tuple[str, float, int] = ("", 0.0, 0)  # by committed rows of this run, and of which commit
        self._opened: Lake | None = None

    def __reduce__(self) -> tuple[object, ...]:
        return (LakeLedger, (self._lake, self._rules))

    @property
    def _replayed(self) -> Lake | None:
        """The lake whose replies stand in, where there is one."""
        if self._opened is None and self._rules.replay:
            self._opened = Lake.existing(self._rules.replay, "replay")
        return self._opened

    def reply(self, call_id: str) -> bytes | None:
        """What a call was answered with; None where it was not."""
        call = self._lake.call(call_id)
        if call is not None and call.reply_blob is not None:
            return self._lake.blobs[call.reply_blob]
        before = self._replayed.call(call_id) if self._replayed is not None else None
        if self._replayed is None or before is None or (before.reply_blob is None and call is not None):
            return None
        blobs = self._replayed.blobs
        return self._kept(before, blobs[before.request_blob], None if before.reply_blob is None else blobs[before.reply_blob])

    @contextlib.contextmanager
    def asking(self, call_id: str, scene_id: str) -> Iterator[None]:
        """Around a call.

        Raises:
            BudgetSpent: the run may make no further one.
            NotRecorded: replies are replayed, and nobody asked for this one.
            EndpointAway, InputError: replies are replayed, and that is what came of this one.
        """
        if self._rules.replay:
            before = self._lake.call(call_id)
            if before is not None and before.outcome == "away":
                raise EndpointAway(str(before.problem))
            if before is not None and before.outcome == "refused":
                raise InputError("replay", before.model, str(before.problem))
            raise NotRecorded(f"{scene_id}: call {call_id[:12]} has no reply in {self._rules.replay}; run without --replay to ask for it")
        self._check_budget()
        mark = self._lake.calls.mark(call_id)
        try:
            yield
        finally:
            self._lake.calls.unmark(mark)

    def request(self) -> None:
        """Before every request of a call: waits for its turn where the run keeps a limit."""
        if self._rules.limit:
            from flows.run.limits import LIMITED, limited

            with limited(LIMITED, {LIMITED: self._rules.limit}):
                pass

    def record(self, call: ModelCall, request: bytes, reply: bytes | None) -> bytes | None:
        """Keep a call; its reply, or that of whoever was first to record one."""
        lost = self._lake.calls.lost(call.call_id)
        kept = self._kept(dataclasses.replace(call, lost=len(lost), run=self._rules.run), request, reply)
        for mark in lost:
            self._lake.calls.unmark(mark)
        return kept

    def _kept(self, call: ModelCall, request: bytes, reply: bytes | None) -> bytes | None:
        blobs = self._lake.blobs
        request_blob = blobs.put(request, "json")
        reply_blob = blobs.put(reply, "txt" if call.kind == "chat" else "glb") if reply is not None else None
        row = dataclasses.replace(call, request_blob=request_blob, reply_blob=reply_blob)
        if self._lake.calls.create(row):
            committed = self._lake.call(call.call_id)  # a commit may have taken the first reply since it was looked for
            if committed is not None and committed.reply_blob not in (None, reply_blob):
                self._lake.calls.discard(row.call_id)
        first = self._lake.call(call.call_id)
        return reply if first is None or first.reply_blob is None else self._lake.blobs[first.reply_blob]

    def _check_budget(self) -> None:
        rules = self._rules
        if rules.budget_usd is None and rules.most_calls is None:
            return
        pending = [call for call in self._lake.calls.all().values() if call.run == rules.run]
        stamp = self._lake.last_commit()
        if self._spent[0] != stamp or not stamp:
            rows = self._lake.snapshot().matching("model_calls", {"run": [rules.run]}, ["cost_usd"])
            self._spent = (stamp, float(pc.sum(rows.column("cost_usd")).as_py() or 0.0), rows.num_rows)
        cost, count = self._spent[1] + sum(call.cost_usd for call in pending), self._spent[2] + len(pending)
        if rules.budget_usd is not None and cost >= rules.budget_usd:
            raise BudgetSpent(f"{SPENT}: {counted(count, 'call')} for {cost:.4g} of {rules.budget_usd:g} USD; run again to go on")
        if rules.most_calls is not None and count >= rules.most_calls:
            raise BudgetSpent(f"{SPENT}: {count} of {counted(rules.most_calls, 'call')}, for {cost:.4g} USD; run again to go on")
