"""What was run on what, as `stage_runs` and the staged runs tell: the current state per (scene, stage)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from schemas.record import arrow_to_rows
from schemas.runs import StageRun

Key = tuple[str, str]
T = TypeVar("T")

BASED_ON = "based_on="
"""How a reason begins that names the scene on which the run's own is based: when that one is erased, so is this one."""


@dataclasses.dataclass(frozen=True, slots=True)
class StageState:
    """The state of a stage on a scene (on an annotation batch for stages of that grain).

    `done` is the run whose rows are in the lake, None when there are none: never run, never succeeded, or
    withdrawn since. `last` is the newest execution, whatever came of it. `is_staged` says that `done` is
    complete but not committed yet, so that its rows are found among the staged ones.
    """

    scene_id: str
    stage: str
    done: StageRun | None
    last: StageRun
    is_staged: bool = False


_ORDER = ("snapshot_id", "started_at", "fingerprint", "attempt")


def order(run: StageRun) -> tuple[object, ...]:
    """What `newest` means among the runs of a stage on a scene: by snapshot, start, fingerprint, attempt."""
    return tuple(getattr(run, name) for name in _ORDER)


def states(runs: pa.Table) -> dict[Key, StageState]:
    """The state of every (scene, stage) from the rows of `stage_runs`."""
    newest = newest_of_each(runs, lambda rows: arrow_to_rows(rows, StageRun))
    return {(last.scene_id, last.stage): StageState(last.scene_id, last.stage, done, last) for done, last in newest}


def newest_of_each(runs: pa.Table, made: Callable[[pa.Table], Sequence[T]]) -> Iterator[tuple[T | None, T]]:
    """The run whose rows are in the lake, None when there are none, and the newest execution, of every (scene, stage).

    Only the rows of `stage_runs` that matter are made records of, by `made`: the newest `done` and the newest execution.
    """
    if not runs.num_rows:
        return
    ordering = [("scene_id", "ascending"), ("stage", "ascending"), *((name, "descending") for name in _ORDER)]
    order = pc.sort_indices(runs.select([name for name, _ in ordering]), sort_keys=ordering)
    keys = runs.select(["scene_id", "stage", "outcome"]).take(order)
    is_done, is_withdrawn = (np.asarray(pc.equal(keys.column("outcome"), outcome)) for outcome in ("done", "withdrawn"))
    groups = _groups(keys)
    kept, last = _first_of_each(groups, is_done | is_withdrawn), _first_of_each(groups, ~is_withdrawn)
    done = np.where((kept >= 0) & is_done[kept], kept, -1)
    wanted = np.union1d(done[done >= 0], last[last >= 0])
    rows = made(runs.take(order.take(pa.array(wanted))))
    for index, newest in zip(_places(wanted, done), _places(wanted, last), strict=True):
        if newest >= 0:
            yield rows[index] if index >= 0 else None, rows[newest]


def _groups(runs: pa.Table) -> NDArray[np.int64]:
    """Number of the (scene, stage) of every row, of rows that are sorted by these."""
    codes = [np.asarray(runs.column(name).combine_chunks().dictionary_encode().indices) for name in ("scene_id", "stage")]
    is_new = np.ones(runs.num_rows, bool)
    is_new[1:] = (codes[0][1:] != codes[0][:-1]) | (codes[1][1:] != codes[1][:-1])
    return np.cumsum(is_new) - 1


def _first_of_each(groups: NDArray[np.int64], is_chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Index of the first chosen row of every group, -1 where there is none."""
    first = np.full(int(groups[-1]) + 1, -1, np.int64)
    indices = np.flatnonzero(is_chosen)[::-1]
    first[groups[indices]] = indices  # of several values for one place, the last one stays: the first row
    return first


def _places(wanted: NDArray[np.int64], indices: NDArray[np.int64]) -> list[int]:
    """Where indices are among those that are wanted; -1 stays."""
    places: list[int] = np.where(indices >= 0, np.searchsorted(wanted, indices), -1).tolist()
    return places


def naming(runs: pa.Table, reasons: Collection[str]) -> set[str]:
    """Scenes of the rows of `stage_runs` that have one of these among their `reasons`."""
    sought, scenes = pa.array(sorted(reasons), pa.string()), set()
    for batch in runs.select(["scene_id", "reasons"]).to_batches():
        listed = batch.column("reasons")
        hits = pc.list_parent_indices(listed).filter(pc.is_in(pc.list_flatten(listed), value_set=sought))
        scenes |= set(batch.column("scene_id").take(hits).to_pylist())
    return scenes


def fingerprints(current: Mapping[Key, StageState]) -> dict[Key, str]:
    """Fingerprint of the rows that are in the lake, per (scene, stage) that has any."""
    return {key: state.done.fingerprint for key, state in current.items() if state.done is not None}


def upstream_of(run: StageRun, stages: Sequence[str]) -> dict[str, str]:
    """Fingerprints of the stages that a run read, by stage. Entries that name no stage are left out."""
    pairs = (entry.split("=", 1) for entry in run.upstream if "=" in entry)
    return {stage: fingerprint for stage, fingerprint in pairs if stage in stages}


def read_elsewhere(run: StageRun) -> dict[Key, str]:
    """Fingerprints of what a run read of several scenes, by (scene, stage)."""
    return parse_elsewhere(run.upstream)


def parse_elsewhere(upstream: Sequence[str]) -> dict[Key, str]:
    """The same, of the entries of an upstream that name a scene: `<stage>@<scene>=<fingerprint>`."""
    pairs = (entry.split("=", 1) for entry in upstream if "@" in entry and "=" in entry)
    return {(place.partition("@")[2], place.partition("@")[0]): fingerprint for place, fingerprint in pairs}


def base_of(run: StageRun) -> str | None:
    """Scene that the scene of a run is based on, as its reasons have it; None for all that are not."""
    return next((reason.removeprefix(BASED_ON) for reason in run.reasons if reason.startswith(BASED_ON)), None)
