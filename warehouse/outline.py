"""The history in outline: what was last run of every (scene, stage), without what takes long to read of many scenes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from schemas.runs import StageRun
from warehouse.history import Key, StageState

COLUMNS = ("scene_id", "stage", "fingerprint", "attempt", "outcome", "reasons", "error", "started_at", "seconds", "snapshot_id")
"""What is read of `stage_runs`."""

_NEWEST_FIRST = ("snapshot_id", "started_at", "fingerprint", "attempt")


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


def outline_of(runs: pa.Table, staged: Mapping[Key, StageState], others: Iterable[StageRun] = ()) -> Outline:
    """The outline of rows of `stage_runs`. States of `staged` take the place of those of the rows; `others` only count as times."""
    states = _states(runs)
    states.update(
        {key: StageOutline(_execution(state.done) if state.done else None, _execution(state.last)) for key, state in staged.items()}
    )
    return Outline(states, _medians(runs, others))


def _states(runs: pa.Table) -> dict[Key, StageOutline]:
    if not runs.num_rows:
        return {}
    ordering = [("scene_id", "ascending"), ("stage", "ascending"), *((name, "descending") for name in _NEWEST_FIRST)]
    order = pc.sort_indices(runs.select([name for name, _ in ordering]), sort_keys=ordering)
    keys = runs.select(["scene_id", "stage", "outcome"]).take(order)
    is_withdrawn = np.asarray(pc.equal(keys.column("outcome"), "withdrawn"))
    is_kept = is_withdrawn | np.asarray(pc.equal(keys.column("outcome"), "done"))
    groups = _groups(keys)
    kept, last = _first_of_each(groups, is_kept), _first_of_each(groups, ~is_withdrawn)
    wanted = np.union1d(kept[kept >= 0], last[last >= 0])
    rows = _rows(runs.take(order.take(pa.array(wanted))))
    found = {}
    for index, newest in zip(_places(wanted, kept), _places(wanted, last), strict=True):
        if newest >= 0:
            key, execution = rows[newest]
            done = rows[index][1] if index >= 0 else None
            found[key] = StageOutline(done if done is not None and done.outcome == "done" else None, execution)
    return found


def _groups(runs: pa.Table) -> NDArray[np.int64]:
    """Number of the (scene, stage) of every row, of rows that are sorted by these."""
    codes = [np.asarray(runs.column(name).combine_chunks().dictionary_encode().indices) for name in ("scene_id", "stage")]
    is_new = np.ones(runs.num_rows, bool)
    is_new[1:] = (codes[0][1:] != codes[0][:-1]) | (codes[1][1:] != codes[1][:-1])
    return np.cumsum(is_new) - 1


def _first_of_each(groups: NDArray[np.int64], is_chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Index of the first chosen row of every group, -1 where there is none."""
    found = np.full(int(groups[-1]) + 1, -1, np.int64)
    indices = np.flatnonzero(is_chosen)[::-1]
    found[groups[indices]] = indices  # of several values for one place, the last one stays: the first row
    return found


def _places(wanted: NDArray[np.int64], indices: NDArray[np.int64]) -> list[int]:
    """Where indices are among those that are wanted; -1 stays."""
    places: list[int] = np.where(indices >= 0, np.searchsorted(wanted, indices), -1).tolist()
    return places


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


def _medians(runs: pa.Table, others: Iterable[StageRun]) -> dict[str, float]:
    done = runs.select(["stage", "seconds"]).filter(pc.equal(runs.column("outcome"), "done"))
    seconds: dict[str, list[float]] = {}
    for run in others:
        if run.outcome == "done":
            seconds.setdefault(run.stage, []).append(run.seconds)
    encoded = done.column("stage").combine_chunks().dictionary_encode()
    codes, taken = np.asarray(encoded.indices), np.asarray(done.column("seconds"))
    for code, stage in enumerate(encoded.dictionary.to_pylist()):
        seconds.setdefault(stage, []).extend(taken[codes == code].tolist())
    return {stage: float(np.median(values)) for stage, values in sorted(seconds.items())}
