"""What the benchmark of the warehouse measures, put together, and held against its goals."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from bench.goals import goal
from bench.machine import machine
from bench.warehouse import generator
from bench.warehouse.answers import time_answers
from bench.warehouse.contention import contention
from bench.warehouse.generator import copied_lake, generated_lake
from bench.warehouse.growth import growth
from bench.warehouse.growth import steps as growth_steps
from bench.warehouse.refusals import try_everything
from bench.warehouse.volumes import pandas_module, ratios, time_volumes
from flows.run.pool import WorkerPool
from warehouse.lake import Lake

PARTS = ("answers", "volumes", "growth", "contention", "refusals")
"""What can be measured on its own."""

ANSWER_SECONDS = 2.0
BOXES_SECONDS = 0.5
MEMORY_MB = 4000.0
FILE_RATIO = 1.3
PANDAS_RATIO = 20.0
REPLACE_SECONDS = 0.5

_SMALL = 30
"""Scenes of the lake that objects are refused on: its files are hashed a hundred times."""


@dataclasses.dataclass(frozen=True)
class WarehouseBench:
    """What is measured. scenes: of the largest lake; a tenth and a hundredth of it are measured beside it. runs: of a query."""

    scenes: int = 100_000
    seed: int = 0
    runs: int = 5
    parts: tuple[str, ...] = PARTS
    contention_scenes: int = 200


def sizes(config: WarehouseBench) -> tuple[int, ...]:
    """Scenes of the lakes that are compared, ascending."""
    return tuple(sorted({max(10, config.scenes // 100), max(10, config.scenes // 10), config.scenes}))


def steps_of(config: WarehouseBench) -> int:
    """How many times `run_warehouse_bench` tells that something is done."""
    lakes = len(sizes(config))
    counts = {"answers": lakes, "volumes": 1, "growth": lakes * growth_steps(), "contention": 1, "refusals": 1}
    return sum(counts[part] for part in config.parts) + lakes * generator.steps()


def run_warehouse_bench(config: WarehouseBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report: sizes of the lakes, times by query and lake, the box plot three ways, commits, contention, refusals, goals.

    Raises:
        InputError: the disk has no room for the lakes, or pandas is not installed.
    """
    if "volumes" in config.parts:
        pandas_module()  # before anything else takes its time
    lakes: dict[int, Lake] = {}
    for scenes in sizes(config):
        lakes[scenes] = generated_lake(scenes, config.seed, partial(_report_table, advance, scenes))
    report: dict[str, Any] = {
        "machine": machine(), "seed": config.seed, "runs": config.runs, "scenes": config.scenes,
        "lakes": {scenes: size_of(lake) for scenes, lake in lakes.items()},
    }  # fmt: skip
    largest = lakes[config.scenes]
    if "answers" in config.parts:
        from flows.stats.queries import when_cut

        report["answers"] = {}
        for scenes, lake in lakes.items():
            report["answers"][scenes] = _alone(time_answers, lake.address, questions(lake), config.runs, when_cut())
            advance(f"answers of {scenes:,} scenes")
    if "volumes" in config.parts:
        report["volumes"] = _alone(time_volumes, largest.address, config.runs)
        advance("the box plot")
    if "growth" in config.parts:
        report["growth"] = [dataclasses.asdict(growth(scenes, config.seed, advance)) for scenes in lakes]
    if "contention" in config.parts:
        with tempfile.TemporaryDirectory(prefix="bench-") as folder:
            report["contention"] = dataclasses.asdict(contention(Path(folder) / "lake", scenes=config.contention_scenes, seed=config.seed))
        advance("contention")
    if "refusals" in config.parts:
        small = generated_lake(_SMALL, config.seed)
        with tempfile.TemporaryDirectory(prefix="bench-", dir=Path(small.address).parent) as folder:
            report["refusals"] = [dataclasses.asdict(attempt) for attempt in try_everything(copied_lake(small, Path(folder) / "lake"))]
        advance("refusals")
    report["goals"] = goals(report)
    return _plain(report)


def questions(lake: Lake) -> dict[str, str]:
    """What the report asks of the newest snapshot of a lake, by name: the view, and after a dot what is asked of it."""
    from flows.stats import report_queries, shown_scenes

    with lake.snapshot().connect() as connection:
        return report_queries(shown_scenes(connection))


def size_of(lake: Lake) -> dict[str, Any]:
    """Rows, files and bytes of a local lake's tables."""
    reader = lake.snapshot()
    with reader.connect() as connection:
        rows = {name: int(connection.sql(f'SELECT count(*) FROM "{name}"').fetchall()[0][0]) for name in sorted(reader.versions)}
    files = {name: reader.files(name) for name in rows}
    sizes_of = {name: sum(Path(lake.address, file).stat().st_size for file in paths) for name, paths in files.items()}
    return {
        "rows": rows, "files": {name: len(paths) for name, paths in files.items()}, "bytes": sizes_of,
        "all_rows": sum(rows.values()), "all_bytes": sum(sizes_of.values()),
    }  # fmt: skip


def goals(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What was measured, held against what was wanted."""
    rows: list[dict[str, Any]] = []
    if "answers" in report:
        largest = report["answers"][report["scenes"]]
        slowest = max(largest["answers"], key=lambda answer: answer.seconds)
        rows.append(goal(f"slowest question of the report, {slowest.name} [s]", slowest.seconds, "<=", ANSWER_SECONDS))
        rows.append(goal("memory of the process that asks them, at most [MB]", largest["peak_memory_mb"], "<=", MEMORY_MB))
    if "volumes" in report:
        volumes = report["volumes"]
        rows.append(goal("box plot of volumes [s]", volumes["lake"].seconds, "<=", BOXES_SECONDS))
        rows.append(goal("box plot: times the time on one file sorted by key", ratios(volumes)["by_key"], "<=", FILE_RATIO))
        rows.append(goal("box plot: times the time on one file sorted by category and volume", ratios(volumes)["sorted"], "<=", FILE_RATIO))
        rows.append(goal("box plot: pandas takes so many times as long", ratios(volumes)["pandas"], ">=", PANDAS_RATIO))
        rows.append(goal("box plot: figures that differ from another way's", sum(volumes["differences"].values()), "==", 0))
    if "growth" in report:
        last = report["growth"][-1]
        for name in ("neighbors", "scattered"):
            rows.append(goal(f"replace 200 scenes of instances, {name} [s]", last[f"{name}_seconds"], "<=", REPLACE_SECONDS))
    if "contention" in report:
        seen = report["contention"]
        rows.append(goal("contention: processes that died of an error", len(seen["errors"]), "==", 0))
        rows += [goal(f"contention: {name}", seen[name], "==", 0) for name in ("halves", "mixed", "lost", "doubled")]
        # Without these the zeros would say nothing.
        rows.append(goal("contention: snapshots that readers looked at", seen["reads"], ">=", 1))
        rows.append(goal("contention: committers killed in mid-commit", seen["in_commit"], ">=", 1))
    if "refusals" in report:
        rows.append(goal("attempts that were not refused", sum(not attempt["refused"] for attempt in report["refusals"]), "==", 0))
        rows.append(goal("attempts that changed something", sum(not attempt["unchanged"] for attempt in report["refusals"]), "==", 0))
    return rows


def _alone(function: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    """`function(*arguments)` in a process of its own, whose memory is that of nothing else."""
    with WorkerPool(1) as pool:
        return pool.call(function, *arguments)


def _report_table(advance: Callable[[str], None], scenes: int, table: str) -> None:
    advance(f"{table} of {scenes:,} scenes")


def _plain(value: Any) -> Any:
    """The same without records of ours, with text for names: fit for JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    return value
