"""Scans of one room held against each other, once all of a run's are captured. Does not import Prefect."""

from __future__ import annotations

import contextlib
import dataclasses
from collections import defaultdict
from collections.abc import Collection
from typing import TYPE_CHECKING

from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from schemas.errors import InputError
from schemas.families.scan_formats import SCAN_FORMATS

if TYPE_CHECKING:
    from flows.run.configuration import Configuration
    from flows.run.plan import Plan, ScenePlan
    from flows.run.report import RunReport
    from flows.worker import Job
    from schemas.runs import StageRun
    from warehouse.lake import Lake

STAGE, CAPTURE = "rescans", "capture"


@dataclasses.dataclass(frozen=True)
class PlannedRescans:
    """Scans that are to be held against earlier ones of their rooms, and runs that failed before on the same input."""

    todo: tuple[Job, ...]
    known: tuple[StageRun, ...]


def with_rescans(
    report: RunReport, lake: Lake, plan: Plan, configuration: Configuration, processes: int, retry_failed: bool = False
) -> RunReport:
    """A run's report, once the rooms of its scenes that were scanned more than once are up to date: what was done is committed."""
    planned = planned_rescans(lake, {scene.scan.scene_id for scene in plan.scenes}, configuration, retry_failed)
    runs = computed(lake, planned.todo, processes)
    anew = [f"{run.scene_id}: {STAGE}: {run.error}" for run in runs if run.error is not None]
    known = [f"{run.scene_id}: {STAGE}: {run.error}" for run in planned.known]
    notes = [f"{run.scene_id}: {STAGE}: {text}" for run in runs for text in run.degradations]
    return dataclasses.replace(
        report,
        failures=(*report.failures, *known, *anew),
        known=(*report.known, *known),
        steps=report.steps + sum(run.error is None for run in runs),
        degradations=(*report.degradations, *notes),
        rescans=tuple(run.scene_id for run in runs if run.error is None),
    )


def planned_rescans(lake: Lake, scenes: Collection[str], configuration: Configuration, retry_failed: bool = False) -> PlannedRescans:
    """What is to be done in the rooms of some scenes: each scan of a room, by name, is held against those before it.

    Only scans count: a finished dataset or a drawn scene of the same room is none. Costs one look at `scenes` where no room has two.
    """
    rooms = rescanned(lake, scenes)
    if not rooms:
        return PlannedRescans((), ())
    from flows.worker import Job
    from tasks.pipeline import MODULES

    config = configuration.stages[STAGE]
    settings_json, code = canonical_json(config), code_fingerprint(MODULES[STAGE])
    history = lake.history({scene for room in rooms for scene in room})
    todo, known = [], []
    for room in rooms:
        prints = {}
        for scene in room:
            state = history.get((scene, CAPTURE))
            if state is not None and state.done is not None:
                prints[scene] = state.done.fingerprint
        captured = list(prints)
        for place in range(1, len(captured)):
            chosen = [captured[place], *reversed(captured[max(0, place - config.earlier) : place])]
            upstream = tuple(f"{CAPTURE}@{scene}={prints[scene]}" for scene in chosen)
            fingerprint = digest("rescans-1", settings_json, code, str(configuration.seed), *upstream)
            state = history.get((chosen[0], STAGE))
            if state is not None and state.done is not None and state.done.fingerprint == fingerprint:
                continue
            is_again = state is not None and state.last.fingerprint == fingerprint
            if state is not None and is_again and state.last.outcome == "failed" and not retry_failed:
                known.append(state.last)
                continue
            todo.append(
                Job(
                    lake=lake.address, scene_id=chosen[0], stage=STAGE, config=config, config_json=settings_json, seed=configuration.seed,
                    fingerprint=fingerprint, reasons=(f"config={digest(settings_json)}", f"code={code}", f"seed={configuration.seed}"),
                    upstream=upstream, attempt=state.last.attempt + 1 if state is not None and is_again else 1,
                    outside=(("rescanned_rooms", tuple(chosen)),),
                )
            )  # fmt: skip
    return PlannedRescans(tuple(todo), tuple(known))


def foreseen_rescans(lake: Lake, plan: Plan, configuration: Configuration, retry_failed: bool = False) -> dict[str, tuple[str, ...]]:
    """Scans that a run would hold against earlier ones of their rooms, sorted, each with these, the nearest first.

    Those of its scenes that it will capture count as captured: what comes of the others is known.
    """
    from tasks.capture.formats import room_of

    jobs = planned_rescans(lake, {scene.scan.scene_id for scene in plan.scenes}, configuration, retry_failed).todo
    held = {job.scene_id: dict(job.outside)["rescanned_rooms"][1:] for job in jobs}
    fresh: dict[str, str] = {}
    for scene in plan.scenes:
        if _is_captured_anew(scene):
            with contextlib.suppress(InputError):  # which its capture will say
                fresh[scene.scan.scene_id] = room_of(scene.scan)
    rooms: defaultdict[str, set[str]] = defaultdict(set)
    for scene_id, room in fresh.items():
        rooms[room].add(scene_id)
    for row in lake.snapshot().matching("scenes", {}, ["scene_id", "room_id", "scan_format"]).to_pylist() if fresh and lake.exists else ():
        if row["scan_format"] in SCAN_FORMATS and row["scene_id"] not in fresh:
            rooms[row["room_id"]].add(row["scene_id"])
    earlier = configuration.stages[STAGE].earlier
    for scans in map(sorted, rooms.values()):
        for place, later in enumerate(scans):
            before = tuple(reversed(scans[max(0, place - earlier) : place]))
            if before and not fresh.keys().isdisjoint((later, *before)):
                held[later] = before
    return dict(sorted(held.items()))


def _is_captured_anew(scene: ScenePlan) -> bool:
    return any(step.stage == CAPTURE and step.action == "run" for step in scene.steps)


def rescanned(lake: Lake, scenes: Collection[str]) -> list[list[str]]:
    """Scenes of every room that some scenes show and more than one scan does, sorted by name each."""
    if not lake.exists or not scenes:
        return []
    rooms: defaultdict[str, list[str]] = defaultdict(list)
    for row in lake.snapshot().matching("scenes", {}, ["room_id", "scan_format"]).to_pylist():
        if row["scan_format"] in SCAN_FORMATS:
            rooms[row["room_id"]].append(row["scene_id"])
    return [sorted(room) for _, room in sorted(rooms.items()) if len(room) > 1 and not set(scenes).isdisjoint(room)]


def computed(lake: Lake, jobs: Collection[Job], processes: int) -> list[StageRun]:
    """The jobs' runs, in their order, over so many processes; their rows are committed."""
    if not jobs:
        return []
    from flows.run.pool import spread_over
    from flows.worker import execute

    runs = spread_over(processes)(execute, list(jobs))
    lake.commit(note="rescans", scenes=[job.scene_id for job in jobs])
    return runs
