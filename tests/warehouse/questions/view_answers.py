"""A DuckDB with the lake's tables, views and macros, rows to fill it with, and ways to compare what it answers."""

from __future__ import annotations

import io
import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from datetime import timedelta
from typing import Any

import pyarrow as pa
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from schemas.capture import Instance, Room, Scene, Shell
from schemas.record import rows_to_arrow, table_of
from schemas.runs import StageRun
from schemas.tables import TABLES
from tests.samples import START, fingerprint, sample, stage_run
from warehouse.questions.answers import Output, write_answer
from warehouse.questions.catalog import empty_lake
from warehouse.questions.sql import Answer

SCENES = ("demo/a", "scannet/scene0001_00", "scannet/scene0001_01")
"""The last two are scans of one room."""
CATEGORIES = ("chair", "mug", "table")
CLASSES = {"chair": (5, "chair"), "mug": (0, "unlabeled"), "table": (5, "chair")}
"""NYU40 classes of the categories; two share one."""
INSTANCES = ("0000", "0001", "0002", "0003")
ASSETS = tuple(fingerprint("asset", name) for name in "xyz")
EXACT = st.integers(0, 640).map(lambda n: n / 64)
"""Multiples of 1/64: quartiles and sums of them are exact, so that nothing depends on rounding."""

quick = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


class Database:
    """An in-memory DuckDB with all tables, empty until filled, all views and all macros."""

    def __init__(self) -> None:
        self.connection = empty_lake()

    def __enter__(self) -> Database:
        return self

    def __exit__(self, *problem: object) -> None:
        self.connection.close()

    def fill(self, *rows: Any) -> None:
        """Make these rows, of any tables, all that there is."""
        by_type: dict[type, list[Any]] = defaultdict(list)
        for row in rows:
            by_type[type(row)].append(row)
        for name in TABLES:
            self.connection.execute(f'DELETE FROM "{name}"')
        for record, of_type in by_type.items():
            self.connection.register("given", rows_to_arrow(of_type, record))
            self.connection.execute(f'INSERT INTO "{table_of(record).name}" SELECT * FROM given')

    def ask(self, question: str) -> list[dict[str, Any]]:
        """Rows of a view, or of a query."""
        sql = question if " " in question else f'SELECT * FROM "{question}"'
        return self.connection.sql(sql).to_arrow_table().to_pylist()


def format_table(data: pa.Table, output: Output = "table", limit: int | None = None) -> str | bytes:
    """Rows as a text table, as CSV, as JSON, as JSON Lines, or as a Parquet file (bytes)."""
    sink = io.BytesIO()
    write_answer(Answer(data.schema, iter(data.to_batches(max_chunksize=100_000))), output, sink, limit)
    return sink.getvalue() if output == "parquet" else sink.getvalue().decode()


def by_key(rows: Sequence[Any], *names: str) -> dict[Any, Any]:
    """Rows by the values of some fields, which must be unique."""
    keyed = {tuple(row[name] for name in names) if len(names) > 1 else row[names[0]]: row for row in rows}
    assert len(keyed) == len(rows)
    return keyed


def same(left: Mapping[str, Any], **right: Any) -> None:
    """Assert fields equal, numbers up to rounding."""
    for name, value in right.items():
        if isinstance(value, float) and left[name] is not None:
            assert math.isclose(left[name], value, rel_tol=1e-12, abs_tol=1e-12), (name, left[name], value)
        else:
            assert left[name] == value, (name, left[name], value)


@st.composite
def scenes(draw: st.DrawFn) -> list[Any]:
    """Scenes, some with a room, some with instances."""
    rows: list[Any] = []
    for scene in draw(st.lists(st.sampled_from(SCENES), unique=True)):
        rows.append(sample(Scene, scene_id=scene, room_id=scene.rsplit("_", 1)[0], license=draw(st.sampled_from([None, "CC-BY-4.0"]))))
        room_count = 0
        if draw(st.booleans()):
            rows.append(sample(Shell, scene_id=scene, room_type=draw(st.sampled_from(["office", "kitchen"])), floor_area_m2=draw(EXACT)))
            room_count = draw(st.integers(1, 3))
        for index in range(room_count):
            kind = draw(st.sampled_from(["office", "kitchen", "unknown"]))
            rows.append(sample(Room, scene_id=scene, room_index=index, room_type=kind, floor_area_m2=draw(EXACT)))
        count = draw(st.integers(0, 12))
        for number in range(count):
            category = draw(st.sampled_from(CATEGORIES))
            rows.append(
                sample(
                    Instance, scene_id=scene, instance_id=f"{number:04d}", category=category, nyu40_id=CLASSES[category][0],
                    nyu40_label=CLASSES[category][1], is_structure=draw(st.sampled_from([False, False, True])), box_volume_m3=draw(EXACT),
                    room_index=draw(st.sampled_from([None, *range(room_count)])),
                )
            )  # fmt: skip
    return rows


@st.composite
def runs(draw: st.DrawFn) -> list[StageRun]:
    """A history of runs, as commits write it: growing snapshots, times and attempts."""
    rows = []
    attempts: Counter[tuple[str, str, str]] = Counter()
    for place in range(draw(st.integers(0, 14))):
        scene = draw(st.sampled_from(SCENES[:2]))
        stage = draw(st.sampled_from(["capture", "captions"]))
        key = (scene, stage, draw(st.sampled_from([fingerprint(1), fingerprint(2)])))
        attempts[key] += 1
        outcome = draw(st.sampled_from(["done", "done", "failed", "lost", "withdrawn"]))
        rows.append(
            stage_run(
                *key, attempt=attempts[key], outcome=outcome, snapshot_id=1 + place // 3, started_at=START + timedelta(seconds=place),
                seconds=draw(EXACT), peak_memory_mb=draw(EXACT),
                host=draw(st.sampled_from(["ada:1", "ada:2", "bob:1"])),
                error="it broke" if outcome == "failed" else None,
                degradations=tuple(draw(st.lists(st.sampled_from(["0001: no view", "0002: no view", "one worker"]), max_size=3))),
            )
        )  # fmt: skip
    return rows


def degrees(radians: float | None) -> float | None:
    return None if radians is None else math.degrees(radians)


def of(rows: Sequence[Any], record: type) -> list[Any]:
    return [row for row in rows if type(row) is record]


def objects_of(rows: Sequence[Any]) -> dict[str, list[Instance]]:
    """Instances that are no structure, by scene; every scene is there."""
    found: dict[str, list[Instance]] = {row.scene_id: [] for row in of(rows, Scene)}
    for row in of(rows, Instance):
        if not row.is_structure:
            found[row.scene_id].append(row)
    return found
