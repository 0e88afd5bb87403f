"""What was run on what, as `stage_runs` and the staged runs tell: the current state per (scene, stage)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import pyarrow as pa

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


def order(run: StageRun) -> tuple[object, ...]:
    """What `newest` means among the runs of a stage on a scene: by snapshot, start, fingerprint, attempt."""
    return (run.snapshot_id, run.started_at, run.fingerprint, run.attempt)


def states(runs: pa.Table) -> dict[Key, StageState]:
    """The state of every (scene, stage) from the rows of `stage_runs`.

    Only the rows that matter are made records of: the newest `done` or `withdrawn` and the newest execution.
    """
    columns = [runs.column(name).to_pylist() for name in ("scene_id", "stage", "outcome", "snapshot_id", "attempt", "fingerprint")]
    started = runs.column("started_at").cast(pa.int64()).to_pylist()
    kept: dict[Key, tuple[tuple[object, ...], int]] = {}
    last: dict[Key, tuple[tuple[object, ...], int]] = {}
    for index, (scene_id, stage, outcome, snapshot_id, attempt, fingerprint) in enumerate(zip(*columns, strict=True)):
        key, place = (scene_id, stage), ((snapshot_id, started[index], fingerprint, attempt), index)
        if outcome in ("done", "withdrawn"):
            kept[key] = max(kept.get(key, place), place)
        if outcome != "withdrawn":
            last[key] = max(last.get(key, place), place)
    wanted = sorted({place[1] for chosen in (kept, last) for place in chosen.values()})
    rows = dict(zip(wanted, arrow_to_rows(runs.take(pa.array(wanted, pa.int64())), StageRun), strict=True))
    found = {}
    for key, (_, index) in last.items():
        done = rows[kept[key][1]] if key in kept else None
        found[key] = StageState(*key, done if done is not None and done.outcome == "done" else None, rows[index])
    return found


def fingerprints(current: Mapping[Key, StageState]) -> dict[Key, str]:
    """Fingerprint of the rows that are in the lake, per (scene, stage) that has any."""
    return {key: state.done.fingerprint for key, state in current.items() if state.done is not None}


def upstream_of(run: StageRun, stages: Sequence[str]) -> dict[str, str]:
    """Fingerprints of the stages that a run read, by stage. Entries that name no stage are left out."""
    pairs = (entry.split("=", 1) for entry in run.upstream if "=" in entry)
    return {stage: fingerprint for stage, fingerprint in pairs if stage in stages}
