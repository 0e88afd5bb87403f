"""What was run on what, as `stage_runs` and the staged runs tell: the current state per (scene, stage)."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import pyarrow as pa
import pyarrow.compute as pc

from schemas.record import arrow_to_rows
from schemas.runs import StageRun

Key = tuple[str, str]


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
    """The state of every (scene, stage) from the rows of `stage_runs`.

    Only the rows that matter are made records of: the newest `done` or `withdrawn` and the newest execution.
    """
    if not runs.num_rows:
        return {}
    newest_first = [("scene_id", "ascending"), ("stage", "ascending"), *((name, "descending") for name in _ORDER)]
    runs = runs.take(pc.sort_indices(runs.select(["scene_id", "stage", *_ORDER]), sort_keys=newest_first))
    withdrawn = pc.equal(runs.column("outcome"), "withdrawn")
    kept = _first_of_each(runs, pc.or_(pc.equal(runs.column("outcome"), "done"), withdrawn))
    last = _first_of_each(runs, pc.invert(withdrawn))
    wanted = sorted({*kept.values(), *last.values()})
    rows = dict(zip(wanted, arrow_to_rows(runs.take(pa.array(wanted, pa.int64())), StageRun), strict=True))
    found = {}
    for key, index in last.items():
        done = rows[kept[key]] if key in kept else None
        found[key] = StageState(*key, done if done is not None and done.outcome == "done" else None, rows[index])
    return found


def naming(runs: pa.Table, reasons: Collection[str]) -> set[str]:
    """Scenes of the rows of `stage_runs` that have one of these among their `reasons`."""
    sought, found = pa.array(sorted(reasons), pa.string()), set()
    for batch in runs.select(["scene_id", "reasons"]).to_batches():
        listed = batch.column("reasons")
        hits = pc.list_parent_indices(listed).filter(pc.is_in(pc.list_flatten(listed), value_set=sought))
        found |= set(batch.column("scene_id").take(hits).to_pylist())
    return found


def _first_of_each(runs: pa.Table, chosen: pa.ChunkedArray) -> dict[Key, int]:
    """Index of the first chosen row of every (scene, stage), of rows that are sorted by these."""
    indices = pc.indices_nonzero(chosen)
    picked = runs.select(["scene_id", "stage"]).take(indices)
    keys = zip(picked.column("scene_id").to_pylist(), picked.column("stage").to_pylist(), strict=True)
    found: dict[Key, int] = {}
    for key, index in zip(keys, indices.to_pylist(), strict=True):
        found.setdefault(key, index)
    return found


def fingerprints(current: Mapping[Key, StageState]) -> dict[Key, str]:
    """Fingerprint of the rows that are in the lake, per (scene, stage) that has any."""
    return {key: state.done.fingerprint for key, state in current.items() if state.done is not None}


def upstream_of(run: StageRun, stages: Sequence[str]) -> dict[str, str]:
    """Fingerprints of the stages that a run read, by stage. Entries that name no stage are left out."""
    pairs = (entry.split("=", 1) for entry in run.upstream if "=" in entry)
    return {stage: fingerprint for stage, fingerprint in pairs if stage in stages}
