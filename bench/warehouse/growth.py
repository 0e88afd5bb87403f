"""What it takes to change a lake, as it grows: commits of whole scenes, and scenes of one large table replaced."""

from __future__ import annotations

import dataclasses
import hashlib
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.warehouse.generator import copied_lake, generated_lake
from schemas.record import arrow_to_rows
from schemas.runs import StageRun
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

    from warehouse.lake import Lake

BATCH = 25
"""Scenes of a commit, as a run of the pipeline makes them."""

REPLACED = 200
"""Scenes of which the rows of one table are replaced."""

TABLE = "instances"
"""The table whose rows are replaced: one row per object, and the widest of these."""

_RUNS = 3


@dataclasses.dataclass(frozen=True)
class Growth:
    """Times [s] on a lake with this many scenes; medians of three.

    commit_new_seconds: `BATCH` scenes that the lake does not have, all tables of scenes and the snapshot; assets and splits,
    which scenes share, stay. commit_again_seconds: as many neighboring scenes with new rows in the place of theirs.
    neighbors_seconds, scattered_seconds: `REPLACED` scenes of `TABLE`, one after the other in the lake or evenly spread over
    it; of a table that is open, without the snapshot. scene_seconds: all rows of one scene, all tables of scenes. outline_seconds: the
    history of all scenes in outline, as `metascenes status` reads it. With `cpu`, seconds of this process's threads on processors,
    which neighbors on the machine hardly change.
    """

    scenes: int
    rows: int
    commit_new_seconds: float
    commit_again_seconds: float
    neighbors_seconds: float
    scattered_seconds: float
    scene_seconds: float
    commit_new_cpu_seconds: float
    outline_seconds: float
    outline_cpu_seconds: float


def growth(scenes: int, seed: int = 0, advance: Callable[[str], None] | None = None) -> Growth:
    """Measure on a copy of a generated lake. `advance` is told each part that is done (`steps()` many)."""
    tell = advance or (lambda part: None)
    original = generated_lake(scenes, seed)
    with tempfile.TemporaryDirectory(prefix="growth-", dir=Path(original.address).parent) as folder:
        lake = copied_lake(original, Path(folder) / "lake")
        names = sorted(lake.snapshot().arrow("scenes").column("scene_id").to_pylist())
        rows = _count(lake, TABLE)
        new = [_commit_seconds(lake, names[i * BATCH % len(names) :][:BATCH], f"new{i}_") for i in range(_RUNS)]
        tell("commits of new scenes")
        again = [_commit_seconds(lake, _spread(names, i)[:BATCH], "")[0] for i in range(_RUNS)]
        tell("commits of scenes anew")
        neighbors = [_replace_seconds(lake, _spread(names, i)[:REPLACED]) for i in range(_RUNS)]
        tell("neighbors replaced")
        step = max(1, len(names) // REPLACED)
        scattered = [_replace_seconds(lake, names[i * step // _RUNS :: step][:REPLACED]) for i in range(_RUNS)]
        tell("scattered scenes replaced")
        samples = [_scene_seconds(lake, names[len(names) // (i + 2)]) for i in range(_RUNS)]
        tell("one scene read")
        outlines = [_timed(lake.outline) for _ in range(_RUNS)]
    median = statistics.median
    new_seconds, new_cpu = map(median, zip(*new, strict=True))
    outline_seconds, outline_cpu = map(median, zip(*outlines, strict=True))
    return Growth(
        scenes=scenes, rows=rows, commit_new_seconds=new_seconds, commit_again_seconds=median(again), neighbors_seconds=median(neighbors),
        scattered_seconds=median(scattered), scene_seconds=median(samples), commit_new_cpu_seconds=new_cpu,
        outline_seconds=outline_seconds, outline_cpu_seconds=outline_cpu,
    )  # fmt: skip


def steps() -> int:
    """How many times `growth` tells its progress."""
    return 5


def stage_copy(lake: Lake, scene: str, name: str, at: float) -> None:
    """Stage all rows of a scene anew, under another name when `name` is not the scene's own; `at` seconds later than they were made.

    Blobs are not looked for: generated rows name some that are not there.
    """
    reader = lake.snapshot()
    runs = {key[1]: state.done for key, state in lake.history([scene]).items() if state.done is not None}
    prints = {stage: hashlib.sha256(f"{name}|{stage}|{run.fingerprint}|{at}".encode()).hexdigest() for stage, run in runs.items()}
    for stage, run in runs.items():
        rows: dict[str, list[Any]] = {}
        for table in TABLES.values():
            if table.stage == stage and table.rule == "replace":
                copied: list[Any] = reader.rows(table.record, scene)
                rows[table.name] = [dataclasses.replace(row, scene_id=name) for row in copied]
        lake.staging.stage(_copied_run(run, name, prints, at), rows)


def _copied_run(run: StageRun, name: str, prints: dict[str, str], at: float) -> StageRun:
    above = [entry.partition("=")[0] for entry in run.upstream]
    return dataclasses.replace(
        run,
        scene_id=name,
        fingerprint=prints[run.stage],
        upstream=tuple(f"{stage}={prints[stage]}" for stage in above if stage in prints),
        started_at=run.started_at + timedelta(seconds=at),
    )


def _commit_seconds(lake: Lake, scenes: Sequence[str], prefix: str) -> tuple[float, float]:
    """Time of one commit of copies of scenes, and that of processors; staging them is not counted."""
    names = {scene: scene.replace("/", f"/{prefix}", 1) for scene in scenes}
    for scene, name in names.items():
        stage_copy(lake, scene, name, at=86_400.0 * 400)
    taken = _timed(lambda: lake.commit("growth", scenes=list(names.values())))
    if lake.has_staged(next(iter(names.values()))):
        raise AssertionError("the staged scenes were not committed")
    return taken


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds that some work takes, and those of processors."""
    clock, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - clock, time.process_time() - cpu


def _replace_seconds(lake: Lake, scenes: Sequence[str]) -> float:
    """Time that replacing these scenes' rows takes in the table once it is open, as a commit does it."""
    reader, table = lake.snapshot(), TABLES[TABLE]
    opened = lake.tables.open(TABLE)
    rows: pa.Table = lake.tables.read(table, lake.tables.files(TABLE, opened) if opened else reader.files(TABLE), only={"scene_id": scenes})
    with lake.leased() as lease:
        writer = lake.tables.writer_from(table, opened, lease.check)
        clock = time.perf_counter()
        writer.replace(rows, "scene_id", scenes)
        return time.perf_counter() - clock


def _scene_seconds(lake: Lake, scene: str) -> float:
    """Time to open the newest snapshot and read all rows of one scene."""
    clock = time.perf_counter()
    reader = lake.snapshot()
    for table in TABLES.values():
        if table.rule == "replace" and table.owner == "scene_id":
            arrow_to_rows(reader.arrow(table.name, scene), table.record)
    return time.perf_counter() - clock


def _spread(names: Sequence[str], number: int) -> Sequence[str]:
    """The scenes from a place on that no other number takes."""
    return names[len(names) * (2 * number + 1) // (2 * _RUNS + 2) :]


def _count(lake: Lake, table: str) -> int:
    import pyarrow.dataset as ds

    storage = lake.storage
    paths = [storage.arrow_path(file) for file in lake.snapshot().files(table)]
    return int(ds.dataset(paths, format="parquet", filesystem=storage.arrow_filesystem()).count_rows())
