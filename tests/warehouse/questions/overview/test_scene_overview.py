"""The overview of scenes, against the lake's own history and a count in Python."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.capture import Room, Scene, Shell
from schemas.optimization import Certificate
from schemas.record import rows_to_arrow
from schemas.runs import StageRun
from tests.samples import sample, stage_run
from tests.warehouse.questions.view_answers import SCENES, Database, by_key, objects_of, of, quick, runs, same, scenes
from warehouse.tables.history import states


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@st.composite
def certificates(draw: st.DrawFn) -> list[Certificate]:
    made = []
    for scene in SCENES:
        for engine in draw(st.sampled_from([(), ("mujoco",), ("mujoco", "newton")])):
            for number in range(draw(st.integers(1, 4))):
                stable, fixed = draw(st.booleans()), draw(st.booleans())
                made.append(
                    sample(Certificate, scene_id=scene, instance_id=f"{number:04d}", engine=engine, is_fixed=fixed, is_stable_5cm=stable)
                )
    return made


@pytest.mark.whole
@quick
@given(rows=scenes(), history=runs(), certified=certificates())
def test_a_scene_is_told_as_its_rows_and_its_history_tell_it(
    database: Database, rows: list[Any], history: list[StageRun], certified: list[Certificate]
) -> None:
    database.fill(*rows, *history, *certified)
    answer = by_key(database.ask("scene_overview"), "scene_id")
    named, shells, objects = by_scene(rows, Scene), by_scene(rows, Shell), objects_of(rows)
    assert list(answer) == sorted({*named, *(run.scene_id for run in history if run.stage == "capture")})
    state = states(rows_to_arrow(history, StageRun))
    for scene_id, row in answer.items():
        own = {stage: found for (scene, stage), found in state.items() if scene == scene_id}
        done = [found.done for found in own.values() if found.done is not None]
        failed = sorted(stage for stage, found in own.items() if found.last.outcome != "done")
        free = [c.is_stable_5cm for c in certified if (c.scene_id, c.engine, c.is_fixed) == (scene_id, "mujoco", False)]
        scene, shell = named.get(scene_id), shells.get(scene_id)
        same(
            row,
            dataset=scene.dataset if scene else scene_id.split("/")[0],
            room_id=scene.room_id if scene else None,
            scan_format=scene.scan_format if scene else None,
            room_type=None if scene is None else shell.room_type if shell else "unknown",
            rooms=sum(room.scene_id == scene_id for room in of(rows, Room)) if scene else None,
            floor_area_m2=shell.floor_area_m2 if shell else None,
            objects=len(objects[scene_id]) if scene else None,
            stages_done=len(done),
            stages_failed=len(failed),
            failed_stages=failed,
            error=next((error for stage in failed if (error := own[stage].last.error)), None),
            seconds=math.fsum(run.seconds for run in done),
            stable_5cm_share=sum(free) / len(free) if free else None,
        )


def by_scene(rows: list[Any], record: type) -> dict[str, Any]:
    return {row.scene_id: row for row in of(rows, record)}


def test_runs_of_what_is_no_scene_are_not_listed(database: Database) -> None:
    database.fill(
        stage_run("batch-1", "annotation", "0" * 64), stage_run("demo/a", "capture", "1" * 64, outcome="failed", error="a: broken")
    )
    (row,) = database.ask("scene_overview")
    assert (row["scene_id"], row["stages_done"], row["failed_stages"], row["error"]) == ("demo/a", 0, ["capture"], "a: broken")
