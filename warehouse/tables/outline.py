"""The history in outline: the last run of every (scene, stage), without the columns that take long to read of many scenes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from schemas.runs import StageRun
from warehouse.tables.history import Key, StageState, newest_of_each

COLUMNS = ("scene_id", "stage", "fingerprint", "attempt", "outcome", "reasons", "error", "started_at", "seconds", "snapshot_id")
"""What is read of `stage_runs`."""


class Execution(NamedTuple):
    """One execution of a stage. `parts` are the `reasons` of its row; `started` is in seconds since the epoch, `seconds` what it took."""

    fingerprint: str
    outcome: str
    parts: tuple[str, ...]
    error: str | None
    started: float
    seconds: float = 0.0


class StageOutline(NamedTuple):
    """The state of a stage on a scene, as `StageState` has it: the run whose rows are there, and the newest execution."""

    done: Execution | None
    last: Execution


@dataclasses.dataclass(frozen=True)
class Outline:
    """The state of every (scene, stage), and the median wall time of a stage's runs that were done [s]."""

    states: Mapping[Key, StageOutline]
    median_seconds: Mapping[str, float]


def outline_of(runs: pa.Table, staged: Mapping[Key, StageState], recent: Iterable[StageRun] = ()) -> Outline:
    """The outline of rows of `stage_runs`. States of `staged` take the place of those of the rows; `recent` only count as times."""
    newest = newest_of_each(runs, _rows)
    states = {key: StageOutline(done and done[1], last) for done, (key, last) in newest}
    states.update(
        {key: StageOutline(_execution(state.done) if state.done else None, _execution(state.last)) for key, state in staged.items()}
    )
    return Outline(states, _medians(runs, recent))


def _rows(runs: pa.Table) -> list[tuple[Key, Execution]]:
    scenes, stages, prints, outcomes, errors = (
        runs.column(name).to_pylist() for name in ("scene_id", "stage", "fingerprint", "outcome", "error")
    )
    reasons = runs.column("reasons").combine_chunks()
    values, ends = reasons.values.to_pylist(), reasons.offsets.to_pylist()
    parts = [tuple(values[begin:end]) for begin, end in pairwise(ends)]
    # As integers: Arrow's way to Python's dates is slow.
    started = (np.asarray(runs.column("started_at").cast(pa.timestamp("us", "UTC")).cast(pa.int64())) / 1e6).tolist()
    seconds = np.asarray(runs.column("seconds")).tolist()
    executions = map(Execution, prints, outcomes, parts, errors, started, seconds)
    return list(zip(zip(scenes, stages, strict=True), executions, strict=True))


def _execution(run: StageRun) -> Execution:
    return Execution(run.fingerprint, run.outcome, run.reasons, run.error, run.started_at.timestamp(), run.seconds)


def _medians(runs: pa.Table, recent: Iterable[StageRun]) -> dict[str, float]:
    done = runs.select(["stage", "seconds"]).filter(pc.equal(runs.column("outcome"), "done"))
    seconds: dict[str, list[float]] = {}
    for run in recent:
        if run.outcome == "done":
            seconds.setdefault(run.stage, []).append(run.seconds)
    encoded = done.column("stage").combine_chunks().dictionary_encode()
    codes, taken = np.asarray(encoded.indices), np.asarray(done.column("seconds"))
    for code, stage in enumerate(encoded.dictionary.to_pylist()):
        seconds.setdefault(stage, []).extend(taken[codes == code].tolist())
    return {stage: float(np.median(values)) for stage, values in sorted(seconds.items())}
