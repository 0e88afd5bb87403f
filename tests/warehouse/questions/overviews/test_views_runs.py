"""When there was work on a lake, what it cost, and which scans it was done for twice, each against a computation of its own."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.capture import Scene
from schemas.runs import StageRun
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.questions.view_answers import SCENES, Database, by_key, quick, same

PAUSE = timedelta(minutes=10)


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@st.composite
def worked(draw: st.DrawFn) -> list[StageRun]:
    """A history in no order, with pauses around ten minutes, runs beside one another, attempts that failed, and withdrawn rows."""
    rows = []
    for number in range(draw(st.integers(0, 12))):
        at = draw(st.sampled_from([0, 1, 300, 599, 600, 601, 1200, 1201, 1800, 3000, 7200]))
        outcome = draw(st.sampled_from(["done", "done", "failed", "lost", "withdrawn"]))
        scene = draw(st.sampled_from([*SCENES, "batch-1"]))
        rows.append(
            stage_run(
                scene, "capture", fingerprint(number), at=float(at), seconds=float(draw(st.sampled_from([0, 1, 600, 900, 1800]))),
                host=draw(st.sampled_from(["ada:1", "ada:2", "bob:1"])), outcome=outcome,
            )
        )  # fmt: skip
    return draw(st.permutations(rows))


def parted(rows: list[StageRun]) -> list[list[StageRun]]:
    """Executions in runs: a run ends where nothing goes on for more than ten minutes."""
    runs: list[list[StageRun]] = []
    for row in sorted((r for r in rows if r.outcome != "withdrawn"), key=lambda r: r.started_at):
        if not runs or row.started_at - max(map(ended, runs[-1])) > PAUSE:
            runs.append([])
        runs[-1].append(row)
    return runs


def ended(row: StageRun) -> Any:
    return row.started_at + timedelta(seconds=row.seconds)


@pytest.mark.whole
@quick
@given(rows=worked(), price=st.none() | st.integers(0, 64).map(lambda n: n / 8))
def test_runs_are_told_by_their_pauses_and_cost_what_machines_cost(database: Database, rows: list[StageRun], price: float | None) -> None:
    database.fill(*rows)
    expected = parted(rows)
    answer = database.ask("run_overview")
    costs = database.ask(f"SELECT * FROM run_costs({'NULL' if price is None else price})")
    assert [row["run_number"] for row in answer] == [row["run_number"] for row in costs] == [n + 1 for n in range(len(expected))]
    for row, cost, run in zip(answer, costs, expected, strict=True):
        wall = (max(map(ended, run)) - min(r.started_at for r in run)).total_seconds()
        on: dict[str, list[StageRun]] = defaultdict(list)
        for one in run:
            on[one.host.split(":")[0]].append(one)
        machine = sum((max(map(ended, some)) - min(r.started_at for r in some)).total_seconds() for some in on.values())
        scenes = len({r.scene_id for r in run if "/" in r.scene_id})
        same(
            row, started_at=min(r.started_at for r in run), ended_at=max(map(ended, run)), wall_seconds=wall, machines=len(on),
            machine_seconds=machine, workers=len({r.host for r in run}), worker_seconds=float(sum(r.seconds for r in run)),
            mean_busy_workers=sum(r.seconds for r in run) / wall if wall else None, stage_runs=len(run),
            failed=sum(r.outcome == "failed" for r in run), lost=sum(r.outcome == "lost" for r in run), scenes=scenes,
            scenes_per_hour=scenes / (wall / 3600) if wall else None,
        )  # fmt: skip
        paid = None if price is None else price * machine / 3600
        same(
            cost, wall_seconds=wall, machine_seconds=machine, scenes=scenes, stage_runs=len(run), cost_usd=paid,
            cost_usd_per_scene=None if paid is None or not scenes else paid / scenes,
            cost_usd_per_hour=None if paid is None or not wall else paid / (wall / 3600),
        )  # fmt: skip
    assert sum(row["stage_runs"] for row in answer) == sum(r.outcome != "withdrawn" for r in rows)


@st.composite
def captured(draw: st.DrawFn) -> list[Any]:
    """Captures of scenes whose scans hold what others hold, under other names or the same, once or again; some were withdrawn."""
    rows: list[Any] = []
    names = [f"demo/{letter}" for letter in "abcdef"]
    for name in draw(st.lists(st.sampled_from(names), unique=True)):
        if draw(st.integers(0, 5)):
            room = draw(st.sampled_from(["demo/one", "other/one", "demo/two"]))
            rows.append(sample(Scene, scene_id=name, room_id=room, scan_path=f"/scans/{name}"))
        for attempt in range(draw(st.integers(1, 2))):
            reasons = (f"scan={draw(st.sampled_from('123'))}", f"content={draw(st.sampled_from('456'))}", "code=7")
            left = reasons[: draw(st.sampled_from([0, 1, 3, 3, 3]))]  # older versions recorded less
            outcome = draw(st.sampled_from(["done", "done", "done", "failed", "withdrawn"]))
            values = {"outcome": outcome, "reasons": left, "snapshot_id": attempt + 1}
            rows.append(stage_run(name, "capture", fingerprint(attempt), at=float(attempt), **values))
        rows.append(stage_run(name, "captions", fingerprint(name), reasons=("scan=1", "content=4")))
    return rows


@quick
@given(rows=captured())
def test_scenes_of_one_scan_are_named_together(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    last: dict[str, StageRun] = {}
    for row in rows:
        if type(row) is StageRun and row.stage == "capture" and row.outcome != "failed":
            last[row.scene_id] = row
    parts = {scene: {p for p in run.reasons if "code" not in p} for scene, run in last.items() if run.outcome == "done"}
    groups: list[set[str]] = []
    for scene, held in parts.items():
        near = [group for group in groups if any(held & parts[other] for other in group)]
        groups = [group for group in groups if group not in near] + [{scene}.union(*near)]
    rooms = {row.scene_id: row for row in rows if type(row) is Scene}
    expected = {}
    for group in groups:
        if len(group) > 1:
            known = {rooms[scene].room_id.partition("/")[2] for scene in group if scene in rooms}
            for scene in group:
                expected[scene] = {
                    "scene_id": scene, "first_scene_id": min(group), "scenes": len(group), "rooms": len(known),
                    "room_id": rooms[scene].room_id if scene in rooms else None,
                    "scan_path": rooms[scene].scan_path if scene in rooms else None,
                }  # fmt: skip
    assert by_key(database.ask("scan_duplicates"), "scene_id") == expected
