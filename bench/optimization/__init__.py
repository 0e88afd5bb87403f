"""The benchmark of the optimization: rooms or a lake's scenes through every method, and timings, as one report."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.machine import machine
from bench.optimization.figures import by_scene, by_state, goals, worst_cases
from bench.optimization.timings import COUNTS, time_chains, time_moves, time_pieces, time_scene
from bench.optimization.verdicts import SceneVerdicts, judge
from bench.rooms import PLAIN, BenchScene, disturbed_scene, generated_scene
from flows.run.fingerprints import ModuleCaches
from flows.run.pool import WorkerPool
from schemas.record import table_of
from tasks.furniture.rooms import furnish
from tasks.stage import Caches

if TYPE_CHECKING:
    from warehouse.lake import Lake


@dataclasses.dataclass(frozen=True)
class SceneJob:
    """A scene to be judged in a worker: room `index` of `rooms`, or a scene of the lake at an address.

    remembered: convex pieces that are known already.
    """

    methods: tuple[str, ...]
    seed: int
    index: int = 0
    rooms: int = 0
    lake: str | None = None
    scene_id: str = ""
    remembered: Mapping[str, bytes] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class BenchConfig:
    """What is measured. rooms: generated ones, where there is no lake. moves_only: nothing but the time per move."""

    methods: tuple[str, ...]
    rooms: int = 50
    seed: int = 0
    lake: str | None = None
    moves_only: bool = False
    processes: int = 1


def run_bench(config: BenchConfig, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report: figures by state, goals, worst cases, figures by scene, timings. `advance` is told what is done.

    Times aside, the same for any number of processes.
    """
    report: dict[str, Any] = {
        "machine": machine(), "seed": config.seed, "processes": config.processes, "methods": list(config.methods),
        "source": config.lake or "generated",
    }  # fmt: skip
    if not config.moves_only:
        report |= _measure_scenes(config, advance)
    with WorkerPool(1) as pool:
        report["moves"] = pool.call(time_moves, config.seed)
        advance("moves")
    report["goals"] = goals(report)
    return report


def steps_of(config: BenchConfig) -> int:
    """How many times `run_bench` tells that something is done."""
    if config.moves_only:
        return 1
    return len(PLAIN) + len(jobs_of(config, {})) + 2 + ("default" in config.methods)


def jobs_of(config: BenchConfig, remembered: Mapping[str, bytes]) -> list[SceneJob]:
    """The scenes to judge, in order.

    Raises:
        InputError: there is no lake at the address.
    """
    job = SceneJob(config.methods, config.seed, rooms=config.rooms, remembered=remembered)
    if config.lake is None:
        return [dataclasses.replace(job, index=index) for index in range(config.rooms)]
    from schemas.selection import Selection

    # scenes that got no further than a failed stage have nothing to place
    chosen = sorted(set(_lake(config.lake).snapshot().arrow(table_of(Selection).name)["scene_id"].to_pylist()))
    return [dataclasses.replace(job, lake=config.lake, scene_id=name) for name in chosen]


def judge_job(job: SceneJob) -> SceneVerdicts:
    """The verdicts on a scene. Runs in a worker, which compiles everything before the clock of its first scene starts."""
    _warm(job.methods)
    if job.lake is None:
        caches: Caches = defaultdict(dict, {"tasks.geometry.pieces": dict(job.remembered)})
        return judge(generated_scene(job.index, job.rooms, job.seed), job.methods, job.seed, caches)
    return judge(scene_of_lake(_lake(job.lake), job.scene_id), job.methods, job.seed, ModuleCaches())


def scene_of_lake(lake: Lake, scene_id: str) -> BenchScene:
    """What the optimization stage reads of a scene in the newest snapshot of a lake."""
    from schemas.annotation import Annotation
    from schemas.candidates import Asset
    from schemas.captions import Caption
    from schemas.capture import Instance, Shell
    from schemas.record import arrow_to_rows
    from schemas.selection import Selection
    from warehouse.tables.reviews import standing_answers

    reader = lake.snapshot()
    records = {"instances": Instance, "captions": Caption, "shells": Shell, "selections": Selection}
    rows: dict[str, list[Any]] = {table: reader.rows(record, scene_id) for table, record in records.items()}
    rows["annotations"] = arrow_to_rows(standing_answers(reader, scene_id), Annotation)
    named = {row.asset_id for row in rows["selections"]} | {row.choice for row in rows["annotations"] if row.choice}
    rows["assets"] = reader.rows_by_key(Asset, sorted(named))
    return BenchScene(scene_id, rows, lake.blobs)


def _measure_scenes(config: BenchConfig, advance: Callable[[str], None]) -> dict[str, Any]:
    """The part of the report that is about scenes."""
    remembered: dict[str, bytes] = {}
    pieces = []
    with WorkerPool(config.processes) as pool, ThreadPoolExecutor(config.processes) as threads:

        def spread(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
            for item, made in zip(items, threads.map(partial(pool.call, function), items), strict=True):
                advance(str(getattr(item, "scene_id", item) or item.index))
                yield made

        for timed, made in spread(time_pieces, PLAIN):  # what the generated rooms hold; a lake has a cache of its own
            pieces.append(timed)
            remembered |= made
        results: list[SceneVerdicts] = list(spread(judge_job, jobs_of(config, remembered)))
    report = {
        "states": by_state(results), "worst": worst_cases(results, config.methods[-1]), "scenes": by_scene(results), "pieces": pieces,
        "disturbances": sum(result.disturbances for result in results),
    }  # fmt: skip
    scene: dict[str, Any] = {"first_seconds": {}}
    for method in config.methods:
        with WorkerPool(1) as pool:  # of its own, so that the first run is the first
            timed = pool.call(time_scene, COUNTS[0], config.seed, (method,), remembered)
        scene = {**timed, **scene, "first_seconds": {**scene["first_seconds"], **timed["first_seconds"]}}
    report["scene"] = scene
    advance("one scene")
    if "default" in config.methods:
        with WorkerPool(2) as pool:
            report["chains"] = time_chains(COUNTS[0], config.seed, remembered, pool.call, 2)
        advance("chains")
    return report


def _lake(address: str) -> Lake:
    from flows.commands.options import existing_lake

    return existing_lake(address)


@cache
def _warm(methods: tuple[str, ...]) -> None:
    """Compile what the methods need, on a small room."""
    rng = np.random.default_rng(0)
    judge(disturbed_scene("bench/warm", furnish("office", rng, 10), rng, plain_share=0.0), methods, 0, defaultdict(dict))
