"""The views of runs and times, each against the lake's own history and NumPy."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from schemas.annotation import Annotation
from schemas.evaluation import Trajectory
from schemas.record import rows_to_arrow
from schemas.runs import StageRun
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.questions.view_answers import (
    SCENES,
    Database,
    by_key,
    objects_of,
    quick,
    runs,
    same,
    scenes,
)
from warehouse.tables.history import states


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@pytest.mark.whole
@quick
@given(history=runs(), rows=scenes())
def test_runs_and_times_agree_with_the_history_of_the_lake(database: Database, history: list[StageRun], rows: list[Any]) -> None:
    database.fill(*rows, *history)
    state = states(rows_to_arrow(history, StageRun))
    current = {key: found.done for key, found in state.items() if found.done is not None}
    answer = by_key(database.ask("current_runs"), "scene_id", "stage")
    assert {key: (row["fingerprint"], row["attempt"]) for key, row in answer.items()} == {
        key: (run.fingerprint, run.attempt) for key, run in current.items()
    }
    failed = {key: found.last for key, found in state.items() if found.last.outcome != "done"}
    failures = by_key(database.ask("failures"), "scene_id", "stage")
    assert {key: (row["outcome"], row["error"]) for key, row in failures.items()} == {k: (r.outcome, r.error) for k, r in failed.items()}
    for key, row in failures.items():
        tried = [r for r in history if (r.scene_id, r.stage, r.fingerprint) == (*key, failed[key].fingerprint)]
        assert row["attempts"] == sum(r.outcome != "withdrawn" for r in tried)
    objects = {scene: len(held) for scene, held in objects_of(rows).items()}
    timing = by_key(database.ask("stage_timing"), "stage")
    assert timing.keys() == {stage for _, stage in current}
    for stage, row in timing.items():
        seconds = {scene: run.seconds for (scene, name), run in current.items() if name == stage}
        counted = {scene: objects.get(scene, 0) for scene in seconds}
        total = sum(counted.values())
        each = sum(s for scene, s in seconds.items() if counted[scene]) / total if total else None
        values = list(seconds.values())
        same(
            row, scenes=len(values), runs=len(values), total_seconds=float(sum(values)), objects=total,
            median_seconds=float(np.median(values)),
            p95_seconds=float(np.percentile(values, 95)), slowest_seconds=max(values), seconds_per_object=each,
        )  # fmt: skip
    hosts = by_key(database.ask("stage_timing_by_host"), "host", "stage")
    assert hosts.keys() == {(run.host.split(":")[0], stage) for (_, stage), run in current.items()}
    for (host, stage), row in hosts.items():
        there = {scene: r for (scene, name), r in current.items() if name == stage and r.host.split(":")[0] == host}
        times, total = [r.seconds for r in there.values()], sum(objects.get(scene, 0) for scene in there)
        spent = sum(r.seconds for scene, r in there.items() if objects.get(scene, 0))
        same(
            row, scenes=len(there), runs=len(there), workers=len({r.host for r in there.values()}), total_seconds=float(sum(times)),
            objects=total,
            median_seconds=float(np.median(times)), p95_seconds=float(np.percentile(times, 95)), slowest_seconds=max(times),
            seconds_per_object=spent / total if total else None, peak_memory_mb=max(r.peak_memory_mb for r in there.values()),
        )  # fmt: skip
    assert sum(row["scenes"] for row in hosts.values()) == sum(row["scenes"] for row in timing.values())
    per_scene = by_key(database.ask("scene_timing"), "scene_id")
    assert per_scene.keys() == {scene for scene, _ in current} & objects.keys()
    for scene, row in per_scene.items():
        spent = {stage: run.seconds for (one, stage), run in current.items() if one == scene}
        slowest = min(spent, key=lambda stage: (-spent[stage], stage))
        same(row, stages=len(spent), total_seconds=float(sum(spent.values())), slowest_stage=slowest, slowest_seconds=spent[slowest])
        same(row, seconds_per_object=sum(spent.values()) / objects[scene] if objects[scene] else None)
    for row in database.ask("stage_outcomes"):
        of_stage = [run for run in history if run.stage == row["stage"]]
        for outcome in ("done", "failed", "lost", "withdrawn"):
            assert row[outcome] == sum(run.outcome == outcome for run in of_stage)
        assert row["runs"] == sum(run.outcome != "withdrawn" for run in of_stage)
    degraded = Counter((run.stage, re.sub(r"^\d+: ", "", text)) for run in current.values() for text in run.degradations)
    assert {(row["stage"], row["degradation"]): row["times"] for row in database.ask("degradation_counts")} == dict(degraded)


def test_scenes_of_batches_are_counted_once_and_runs_as_they_are(database: Database) -> None:
    batches = {"expert": SCENES[:2], "chance": SCENES[:2], "gone": (), "answers": SCENES[1:]}
    stages = {"expert": "evaluation", "chance": "evaluation", "gone": "evaluation", "answers": "annotation"}
    rows: list[Any] = [stage_run(name, stages[name], fingerprint(name), host=f"{name[0]}:1", degradations=("lost",)) for name in batches]
    rows += [stage_run(scene, "capture", fingerprint(scene), degradations=("too dark",)) for scene in SCENES]
    for name, about in batches.items():
        kind, more = (Annotation, {"choice": None}) if name == "answers" else (Trajectory, {})
        key = "episode_id" if kind is Trajectory else "instance_id"
        rows += [sample(kind, batch_id=name, scene_id=scene, **{key: f"{n:04d}"}, **more) for scene in about for n in range(3)]
    database.fill(*rows)
    timing = by_key(database.ask("stage_timing"), "stage")
    assert {stage: (row["scenes"], row["runs"]) for stage, row in timing.items()} == {
        "capture": (3, 3), "evaluation": (2, 3), "annotation": (2, 1),
    }  # fmt: skip
    hosts = by_key(database.ask("stage_timing_by_host"), "host", "stage")
    assert {key: (row["scenes"], row["runs"]) for key, row in hosts.items() if key[1] == "evaluation"} == {
        ("e", "evaluation"): (2, 1), ("c", "evaluation"): (2, 1), ("g", "evaluation"): (0, 1),
    }  # fmt: skip
    told = {(row["stage"], row["degradation"]): (row["times"], row["scenes"]) for row in database.ask("degradation_counts")}
    assert told == {("capture", "too dark"): (3, 3), ("evaluation", "lost"): (3, 0), ("annotation", "lost"): (1, 0)}
