"""What a commit takes in and what it takes out: a plan made of rows of `stage_runs` alone, before anything is written.

A staged run is adopted when the fingerprints of the stages that it read are those of the snapshot being built.
What was computed from rows that are no longer there is withdrawn in the same snapshot.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime, timedelta

from schemas.runs import StageRun
from schemas.tables import TABLES
from warehouse.tables.history import Key, StageState, fingerprints, order, read_elsewhere, upstream_of
from warehouse.tables.staging import StagedRun

STAGES: tuple[str, ...] = tuple(dict.fromkeys(table.stage for table in TABLES.values() if table.stage))
"""All stages in the order of the data path, which is the order of the tables."""

_REPLACED = {table.stage: table.grain for table in TABLES.values() if table.stage and table.rule == "replace"}

SCENE_STAGES: tuple[str, ...] = tuple(stage for stage, grain in _REPLACED.items() if grain == "scene")
"""Stages whose rows belong to a scene: these are adopted and withdrawn by what they read."""

WHOLE_STAGES = frozenset(_REPLACED) - {*SCENE_STAGES}
"""Stages whose rows belong to something else, and take the place of all that it had: of several staged runs the last counts."""


ACROSS_STAGES = frozenset(stage for stage, grain in _REPLACED.items() if grain == "rescan")
"""Those of them that read rows of several scenes: they are adopted and withdrawn by what they read, as those of one scene are."""


@dataclasses.dataclass(frozen=True)
class CommitPlan:
    """What a commit does.

    `adopted` are the staged runs whose rows go in, one per (scene, stage) for stages whose rows are replaced; `recorded`
    the staged runs of which only the row is kept (failed, or overtaken by a newer one in the same commit);
    `withdrawn` the runs whose rows go out without any taking their place. `left` cannot be adopted as things stand.
    """

    adopted: tuple[StagedRun, ...]
    recorded: tuple[StagedRun, ...]
    withdrawn: tuple[StageRun, ...]
    left: tuple[StagedRun, ...]

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to do."""
        return not (self.adopted or self.recorded or self.withdrawn)


def plan(current: Mapping[Key, StageState], staged: Sequence[StagedRun], removed: Collection[str] = ()) -> CommitPlan:
    """The plan of a commit: from the states in the last snapshot, what is staged, and scenes to remove."""
    prints = fingerprints(current)
    adopted: dict[Key, StagedRun] = {}
    adopted_batches: list[StagedRun] = []
    whole: dict[Key, StagedRun] = {}
    recorded, left, withdrawn = [], [], []
    waiting: dict[Key, list[StagedRun]] = {}
    for staged_run in sorted(staged, key=_staged_order):
        if staged_run.run.scene_id in removed and staged_run.run.outcome == "done":
            left.append(staged_run)
        elif staged_run.run.outcome != "done":
            recorded.append(staged_run)
        elif staged_run.run.stage in WHOLE_STAGES:
            key = (staged_run.run.scene_id, staged_run.run.stage)
            recorded.extend([whole.pop(key)] if key in whole else [])
            whole[key] = staged_run
        elif staged_run.run.stage not in SCENE_STAGES:
            adopted_batches.append(staged_run)
        else:
            waiting.setdefault((staged_run.run.scene_id, staged_run.run.stage), []).append(staged_run)
    scenes = sorted({scene for scene, _ in waiting} | {scene for scene, _ in prints if scene in removed})
    for scene in scenes:
        for stage in SCENE_STAGES:
            key = (scene, stage)
            fits = [staged_run for staged_run in waiting.get(key, ()) if scene not in removed and _is_current(staged_run.run, prints)]
            left.extend(staged_run for staged_run in waiting.get(key, ()) if staged_run not in fits)
            if fits:
                adopted[key] = fits[-1]
                recorded.extend(fits[:-1])
                prints[key] = fits[-1].run.fingerprint
            elif key in prints and (scene in removed or not _is_current(_done(current, key), prints)):
                withdrawn.append(_done(current, key))
                del prints[key]
    left += [whole.pop(key) for key, staged_run in list(whole.items()) if _is_outdated(staged_run.run, prints, None)]
    known = {scene for scene, _ in current}
    for key, state in current.items():
        if key[1] in ACROSS_STAGES and key not in whole and state.done is not None and _is_outdated(state.done, prints, known):
            withdrawn.append(state.done)
    return CommitPlan((*adopted.values(), *whole.values(), *adopted_batches), tuple(recorded), tuple(withdrawn), tuple(left))


def committed_rows(made: CommitPlan, attempts: Mapping[tuple[str, str, str], int], snapshot_id: int, now: datetime) -> list[StageRun]:
    """Rows that a commit adds to `stage_runs`.

    `attempts` gives the highest attempt of every (scene, stage, fingerprint) so far. Attempts that are taken are
    counted on, so that the key stays unique.
    """
    highest = dict(attempts)
    rows = []
    for staged_run in sorted((*made.adopted, *made.recorded), key=_staged_order):
        rows.append(_numbered(staged_run.run, highest, snapshot_id))
    starts = {(row.scene_id, row.stage): row.started_at for row in rows}
    for run in made.withdrawn:
        # Later than anything of this commit: a withdrawn row must come last, whatever the clocks of other hosts say.
        started = max(now, starts.get((run.scene_id, run.stage), now) + timedelta(microseconds=1))
        row = dataclasses.replace(run, outcome="withdrawn", row_counts=(), degradations=(), error=None, error_kind=None)
        row = dataclasses.replace(row, started_at=started, seconds=0.0, peak_memory_mb=0.0)
        rows.append(_numbered(row, highest, snapshot_id))
    return rows


def without_faults(staged: Sequence[StagedRun], faults: Mapping[str, str]) -> list[StagedRun]:
    """The staged runs, those with faulty files (by token) as lost: reported, and run again next time."""
    sound = []
    for staged_run in staged:
        if staged_run.token in faults:
            run = dataclasses.replace(staged_run.run, outcome="lost", error=faults[staged_run.token], error_kind="lost", row_counts=())
            staged_run = dataclasses.replace(staged_run, run=run)
        sound.append(staged_run)
    return sound


def overlaid(current: Mapping[Key, StageState], made: CommitPlan) -> dict[Key, StageState]:
    """The states as they will be once a plan is committed."""
    after = dict(current)
    for staged_run in sorted((*made.recorded, *made.adopted), key=_staged_order):
        key = (staged_run.run.scene_id, staged_run.run.stage)
        before = after.get(key)
        after[key] = StageState(*key, before.done if before else None, staged_run.run, before.is_staged if before else False)
    for staged_run in made.adopted:
        key = (staged_run.run.scene_id, staged_run.run.stage)
        after[key] = dataclasses.replace(after[key], done=staged_run.run, is_staged=True)
    for run in made.withdrawn:
        key = (run.scene_id, run.stage)
        after[key] = dataclasses.replace(after[key], done=None, is_staged=False)
    return after


def now_utc() -> datetime:
    """The present time, to the microsecond, in UTC."""
    return datetime.now(UTC)


def _staged_order(staged_run: StagedRun) -> tuple[object, ...]:
    return (staged_run.run.scene_id, staged_run.run.stage, *order(dataclasses.replace(staged_run.run, snapshot_id=0)), staged_run.token)


def _is_current(run: StageRun, prints: Mapping[Key, str]) -> bool:
    """Whether all that a run read is what the snapshot being built holds."""
    return all(prints.get((run.scene_id, stage)) == fingerprint for stage, fingerprint in upstream_of(run, SCENE_STAGES).items())


def _is_outdated(run: StageRun, prints: Mapping[Key, str], known: Collection[str] | None) -> bool:
    """Whether a run read rows of several scenes of which the snapshot being built does not hold some; of scenes that are `known`, if
    given: of others nobody has looked."""
    return any(
        prints.get((scene, stage)) != fingerprint
        for (scene, stage), fingerprint in read_elsewhere(run).items()
        if known is None or scene in known
    )


def _done(current: Mapping[Key, StageState], key: Key) -> StageRun:
    done = current[key].done
    if done is None:
        raise ValueError(f"{key} has no rows in the lake")
    return done


def _numbered(row: StageRun, highest: dict[tuple[str, str, str], int], snapshot_id: int) -> StageRun:
    key = (row.scene_id, row.stage, row.fingerprint)
    attempt = row.attempt if row.attempt > highest.get(key, 0) else highest[key] + 1
    highest[key] = attempt
    return dataclasses.replace(row, attempt=attempt, snapshot_id=snapshot_id)
