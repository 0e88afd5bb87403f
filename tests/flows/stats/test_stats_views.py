"""The views behind the heat map, the timeline and the growth, and what the report asks of them, each against plain Python."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from flows.stats import queries
from flows.stats.queries import ShownScenes, report_queries
from schemas.capture import Instance, Room, Scene
from schemas.runs import Release
from schemas.synthesis import Synthesis, SynthesisObject
from tasks.micro_scenes.charts import LAYOUT_LIMIT
from tests.samples import START, fingerprint, sample, stage_run
from tests.warehouse.questions.view_answers import Database

quick = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    made = Database()
    yield made
    made.connection.close()


def ask(database: Database, name: str, scenes: ShownScenes | None = None) -> list[dict[str, Any]]:
    return database.connection.sql(report_queries(scenes or ShownScenes())[name]).to_arrow_table().to_pylist()


OBJECTS = st.lists(
    st.tuples(st.sampled_from(["a", "b", "c"]), st.sampled_from(["chair", "mug", "lamp"]), st.sampled_from([False, False, True])),
    max_size=40,
)


@given(objects=OBJECTS, types=st.dictionaries(st.sampled_from(["a", "b", "c"]), st.sampled_from(["office", "kitchen"])))
@quick
def test_categories_by_room_type(database: Database, objects: list[tuple[str, str, bool]], types: dict[str, str]) -> None:
    rows: list[Any] = [sample(Scene, scene_id=f"demo/{scene}") for scene in "abc"]
    rows += [sample(Room, scene_id=f"demo/{scene}", room_index=0, room_type=kind) for scene, kind in types.items()]
    counts: Counter[tuple[str, str]] = Counter()
    scenes: dict[tuple[str, str], set[str]] = defaultdict(set)
    for number, (scene, category, is_structure) in enumerate(objects):
        rows.append(sample(Instance, scene_id=f"demo/{scene}", instance_id=f"{number:04d}", category=category, is_structure=is_structure))
        if not is_structure:
            cell = (types.get(scene, "unknown"), category)
            counts[cell] += 1
            scenes[cell].add(scene)
    database.fill(*rows)
    found = {(row["room_type"], row["category"]): (row["objects"], row["scenes"]) for row in database.ask("category_by_room_type")}
    assert found == {cell: (count, len(scenes[cell])) for cell, count in counts.items()}
    drawn = {(row["room_type"], row["category"]): row["objects"] for row in ask(database, "category_by_room_type")}
    assert drawn == dict(counts)


RUNS = st.lists(
    st.tuples(
        st.integers(0, 5000), st.integers(0, 600), st.sampled_from(["vm:1", "vm:2", "other:1"]), st.sampled_from(["capture", "captions"])
    ),
    min_size=1,
    max_size=25,
)


def timeline(database: Database, runs: list[tuple[int, int, str, str]]) -> list[tuple[int, int, str, str]]:
    """Fill in the runs, each of a scene of its own; in order."""
    rows = [
        stage_run(f"demo/{n:03d}", stage, fingerprint(n), at=float(at), seconds=float(seconds), host=host)
        for n, (at, seconds, host, stage) in enumerate(runs)
    ]
    database.fill(*rows)
    return sorted(runs)


def at_work(runs: list[tuple[int, int, str, str]]) -> tuple[list[tuple[str, str, float, float]], list[tuple[float, float]]]:
    """Worker, stage, begin and end of each run on an axis without pauses, and the pauses: walking through the runs in time."""
    placed, pauses = [], []
    shift, busy_until = runs[0][0], runs[0][0]
    for at, seconds, host, stage in sorted(runs, key=lambda run: (run[0], run[0] + run[1])):
        if at - busy_until > queries.PAUSE_SECONDS:
            shift += at - busy_until
            pauses.append((float(at - shift), float(at - busy_until)))
        placed.append((host, stage, float(at - shift), float(at - shift + seconds)))
        busy_until = max(busy_until, at + seconds)
    return sorted(placed), sorted(pauses)


@given(runs=RUNS)
@quick
def test_the_timeline_leaves_out_what_nobody_worked(database: Database, runs: list[tuple[int, int, str, str]]) -> None:
    placed, pauses = at_work(timeline(database, runs))
    found = ask(database, "run_timeline")
    assert sorted((row["host"], row["stage"], row["begins"], row["ends"]) for row in found) == placed
    assert all((row["share"], row["runs"]) == (1.0, 1) for row in found)
    assert sorted((row["at"], row["seconds"]) for row in ask(database, "run_timeline.pauses")) == pauses
    assert ask(database, "run_timeline.workers") == [{"workers": len({host for _, _, host, _ in runs})}]


@given(runs=RUNS)
@quick
def test_bins_of_time_lose_no_second_and_no_run(database: Database, runs: list[tuple[int, int, str, str]]) -> None:
    placed, _ = at_work(timeline(database, runs))
    binned = ask(database, "run_timeline.binned")
    assert sum(row["runs"] for row in binned) == len(runs)
    for host, stage in {(host, stage) for host, stage, _, _ in placed}:
        seconds = sum((row["ends"] - row["begins"]) * row["share"] for row in binned if (row["host"], row["stage"]) == (host, stage))
        assert seconds == pytest.approx(sum(end - begin for h, s, begin, end in placed if (h, s) == (host, stage)), abs=1e-6)
    end = max(end for _, _, _, end in placed)
    assert all(-1e-6 <= row["begins"] < row["ends"] <= max(end, 1e-6) * (1 + 1e-9) for row in binned)
    assert len({row["begins"] for row in binned}) <= queries.TIMELINE_BINS


def test_a_run_ends_its_seconds_after_its_start(database: Database) -> None:
    database.fill(stage_run("demo/a", "capture", fingerprint(1), seconds=12.345678, host="vm:1"))
    (row,) = database.ask("run_timeline")
    assert row["ended_at"] - row["started_at"] == timedelta(seconds=12.345678)
    assert row["host"] == "vm:1"


def test_growth_is_in_the_order_of_the_snapshots(database: Database) -> None:
    releases = [
        sample(Release, name=name, snapshot_id=snapshot, created_at=START + timedelta(days=day), scenes=snapshot, row_counts=())
        for name, snapshot, day in (("v2", 20, 3), ("v1", 4, 2), ("v2-again", 20, 9), ("early", 2, 50))
    ]
    database.fill(*releases)
    order = ["early", "v1", "v2", "v2-again"]
    assert [row["name"] for row in database.ask("dataset_growth")] == order
    assert [(row["name"], row["scenes"]) for row in ask(database, "dataset_growth")] == list(zip(order, (2, 4, 20, 20), strict=True))


def test_layouts_are_drawn_of_the_large_object_with_the_most_of_them(database: Database) -> None:
    """Eight layouts on a desk in an office, each with as many objects as its number says, beside fewer on others."""
    asked = [("desk", "office", 8), ("desk", "kitchen", 3), ("table", "office", 7)]
    scenes = [
        sample(
            Synthesis, scene_id=f"{category}-{room_type}/{n}", category=category, room_type=room_type, box_size=(0.7, 1.4, 0.75), number=n
        )
        for category, room_type, count in asked
        for n in range(count)
    ]
    objects = [sample(SynthesisObject, scene_id=row.scene_id, instance_id=f"{n:04d}") for row in scenes for n in range(row.number)]
    database.fill(*scenes, *objects)
    found = ask(database, "synthesis_layouts")
    expected: dict[str, list[str | None]] = {f"desk-office/{n}": [f"{at:04d}" for at in range(n)] for n in range(1, LAYOUT_LIMIT)}
    expected["desk-office/0"] = [None]
    by_scene: dict[str, list[str | None]] = defaultdict(list)
    for row in found:
        by_scene[row["scene_id"]].append(row["instance_id"])
        assert (row["large_category"], row["room_type"], row["large_box_size"]) == ("desk", "office", [0.7, 1.4, 0.75])
    assert by_scene == expected
    database.fill(scenes[0], scenes[-1])
    assert ask(database, "synthesis_layouts") == []  # nothing to hold side by side
