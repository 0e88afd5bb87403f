"""Timings of the optimization: per move against plain Python, of a whole scene, of convex pieces, of chains on processes."""

from __future__ import annotations

import dataclasses
import hashlib
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, MutableMapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from bench.optimization.plain import compare, compiled_seconds
from bench.optimization.verdicts import config_of, context_of, optimized
from bench.rooms import plain_asset, scene_of_count
from tasks.geometry.meshes import dump_glb, load_glb
from tasks.geometry.pieces import asset_pieces
from tasks.optimization import OptimizationConfig

COUNTS = (39, 100, 300, 1000)
"""Objects in the rooms that moves are timed in; 39 is the mean of the paper's scenes."""

RUNS = 3
"""Runs of a warm scene; their median counts."""


def time_moves(seed: int, counts: Sequence[int] = COUNTS) -> dict[str, Any]:
    """Algorithm 1 in plain Python and compiled on the same moves in a room of 39 objects; time per move by number of objects [s].

    All times are medians of as many runs.
    """
    return {**compare(COUNTS[0], seed), "seconds_per_move": {str(count): compiled_seconds(count, seed) for count in counts}}


def time_pieces(category: str) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Cold time of the convex pieces of the asset of a category that has none [s], and what a cache remembers of it."""
    glb = dump_glb(plain_asset(category))
    cache: dict[str, bytes] = {}
    clock = time.perf_counter()
    made = asset_pieces(hashlib.sha256(glb).hexdigest(), lambda: load_glb(glb), None, OptimizationConfig().pieces, cache)
    seconds = time.perf_counter() - clock
    return {"category": category, "method": made.method, "pieces": len(made.hulls), "seconds": seconds}, cache


def time_scene(count: int, seed: int, methods: Sequence[str], remembered: MutableMapping[str, bytes]) -> dict[str, Any]:
    """Seconds of the stage on a scene of `count` objects by method, its convex pieces remembered.

    By method the median of `RUNS` runs in a warm process. first_seconds: of the run before those. It reads from the disk
    what is compiled, or compiles it; to be the first for a method, it has to be in a process that has done nothing yet.
    """
    scene = scene_of_count(count, seed)
    context = context_of(scene, seed, defaultdict(dict, {"tasks.geometry.pieces": remembered}))
    times: dict[str, Any] = {"count": count, "first_seconds": {}}
    for method in methods:
        runs = []
        for _ in range(1 + RUNS):
            clock = time.perf_counter()
            optimized(scene, config_of(method), context)
            runs.append(time.perf_counter() - clock)
        times["first_seconds"][method], times[method] = runs[0], statistics.median(runs[1:])
    return times


def time_chains(count: int, seed: int, remembered: MutableMapping[str, bytes], call: Callable[..., Any], processes: int) -> dict[str, Any]:
    """Seconds of the default method on a scene of `count` objects, its chains in turn and spread over processes by `call`.

    is_same: both give the same rows.
    """
    scene = scene_of_count(count, seed)
    alone = context_of(scene, seed, defaultdict(dict, {"tasks.geometry.pieces": remembered}))

    def spread(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        with ThreadPoolExecutor(max(1, processes)) as threads:
            return list(threads.map(lambda item: call(function, item), items))

    together = dataclasses.replace(alone, spread=spread)
    seconds, rows = {}, []
    for name, context in (("1", alone), (str(processes), together)):
        optimized(scene, config_of("default"), context)
        clock = time.perf_counter()
        rows.append(optimized(scene, config_of("default"), context).rows)
        seconds[name] = time.perf_counter() - clock
    return {"count": count, "seconds_by_processes": seconds, "is_same": rows[0] == rows[1]}
