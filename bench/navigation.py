"""The benchmark of navigation: path finders against each other and against plain visibility graphs, and episodes replayed."""

from __future__ import annotations

import dataclasses
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.goals import goal
from bench.machine import machine
from bench.paths import PlainGraph, replayed
from bench.replicas import as_drawn
from bench.rooms import generated_scene
from bench.tables import add_row, goals_table, headline, table_of
from flows.run.pool import WorkerPool
from schemas.errors import InputError
from tasks import navigation
from tasks.navigation import NavigationConfig
from tasks.navigation.planar import PlanarConfig
from tasks.navigation.recast import RecastConfig
from tasks.stage import Context

if TYPE_CHECKING:
    import shapely
    from rich.console import Console

    from schemas.navigation import Episode
    from tasks.navigation.protocol import PathFinder
    from tasks.stage import Outcome

Array = NDArray[np.float64]

PAIRS = 500
"""Pairs of points whose lengths are compared in every room."""

TIMED_PAIRS = 100
"""Pairs of points whose distance is asked one by one against the clock, as of the 100 episodes of a training scene."""

SLACK_M = 1e-3
"""What an exact path may be longer than Detour's [m]: single precision of its corners."""


@dataclasses.dataclass(frozen=True)
class NavigationBench:
    """What is measured."""

    rooms: int = 10
    seed: int = 0
    processes: int = 1


@dataclasses.dataclass(frozen=True)
class Trajectories:
    """Episodes of one path finder in one room. seconds: of the whole stage, which made `asked` or fewer.

    off: episodes whose actions, replayed by themselves, leave the navmesh by more than 0.1 mm. missed: that end farther from
    every view point than the success distance.
    """

    seconds: float
    asked: int
    made: int
    steps: int
    off: int
    missed: int


@dataclasses.dataclass(frozen=True)
class RoomPaths:
    """One room. lengths: of the same pairs [m], straight and by each path finder on Detour's own polygons, shape (n,).

    query_seconds: per distance by path finder, what it prepares for a room included. plain_seconds: the same by a plain
    visibility graph. plain_difference_m: greatest difference of its lengths from those of `planar`.
    """

    scene_id: str
    objects: int
    corners: int
    trajectories: Mapping[str, Trajectories]
    lengths: Mapping[str, Array]
    query_seconds: Mapping[str, float]
    plain_seconds: float
    plain_difference_m: float


def run_navigation_bench(config: NavigationBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report: lengths, times, episodes, goals. `advance` is told each room that is done."""
    with WorkerPool(config.processes) as pool, ThreadPoolExecutor(config.processes) as threads:
        rooms: list[RoomPaths] = []
        for number, room in enumerate(threads.map(partial(pool.call, measure_room, config), range(config.rooms))):
            advance(f"room {number}")
            rooms += [room] if room is not None else []
    if not rooms:
        raise InputError("bench", "rooms", f"the agent finds no free floor in any of {config.rooms}", "give another --seed or more --rooms")
    report = {
        "machine": machine(), "seed": config.seed, "processes": config.processes, "rooms": len(rooms),
        "rooms_without_floor": config.rooms - len(rooms),
        "objects": sum(room.objects for room in rooms), "has_recast": has_recast(),
        "corners_mean": float(np.mean([room.corners for room in rooms])),
        "query_microseconds": {name: 1e6 * _mean([room.query_seconds[name] for room in rooms]) for name in rooms[0].query_seconds},
        "plain_microseconds": 1e6 * _mean([room.plain_seconds for room in rooms]),
        "times_faster_than_plain": _mean([room.plain_seconds / room.query_seconds["planar"] for room in rooms]),
        "plain_difference_m": max(room.plain_difference_m for room in rooms),
        "ratio": _ratio(rooms),
        "episodes": {name: _episodes([room.trajectories[name] for room in rooms]) for name in rooms[0].trajectories},
    }  # fmt: skip
    return report | {"goals": goals(rooms, report)}


def goals(rooms: Sequence[RoomPaths], report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Exact paths are bounded by what they must be, and episodes end where they should."""
    longer = shorter = None
    if report["has_recast"]:
        longer = sum(int((room.lengths["planar"] > room.lengths["recast"] + SLACK_M).sum()) for room in rooms)
    shorter = sum(int((room.lengths[name] < room.lengths["straight"] - SLACK_M).sum()) for room in rooms for name in room.lengths)
    episodes = report["episodes"].values()
    return [
        goal("paths of planar longer than Detour's on the same navmesh by more than 1 mm", longer, "<=", 0),
        goal("paths shorter than the straight line", shorter, "<=", 0),
        goal("greatest difference of planar from a plain visibility graph [m]", report["plain_difference_m"], "<=", 1e-6),
        goal("times faster per distance than the plain graph", report["times_faster_than_plain"], ">=", 5.0),
        goal("episodes that leave the navmesh in replay", sum(episode["off"] for episode in episodes), "<=", 0),
        goal("episodes that end farther than 0.2 m from every view point", sum(episode["missed"] for episode in episodes), "<=", 0),
    ]


def has_recast() -> bool:
    """Whether the path finder `recast` can be used here."""
    from tasks.navigation.recast import bake

    try:
        bake(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), NavigationConfig().settings)
    except InputError:
        return False
    return True


def measure_room(config: NavigationBench, index: int) -> RoomPaths | None:
    """One room through every path finder that can be used; None where objects leave the agent no floor.

    Runs in a worker, which is warm before the clock starts.
    """
    scene = generated_scene(index, config.rooms, config.seed)
    rows, blobs = as_drawn(scene)
    configs = {"planar": NavigationConfig(path_finder=PlanarConfig())}
    if has_recast():
        configs["recast"] = NavigationConfig(path_finder=RecastConfig())
    trajectories, meshes = {}, {}
    for name, settings in configs.items():
        context = Context(scene.scene_id, "navigation", config.seed, blobs, defaultdict(dict))
        needed = {table: rows[table] for table in navigation.STAGE.reads}
        warm = dataclasses.replace(settings, train_episodes=1, test_episodes=1)
        if not navigation.run(**needed, context=context, config=warm).rows["navmeshes"]:
            return None
        clock = time.perf_counter()
        outcome = navigation.run(**needed, context=context, config=settings)
        seconds = time.perf_counter() - clock
        trajectories[name] = _judged(outcome, settings, seconds)
        meshes[name] = outcome.blobs[outcome.rows["navmeshes"][0].navmesh_blob]
    rng = np.random.default_rng([config.seed, index])
    lengths = _lengths(meshes.get("recast", meshes["planar"]), rng, "recast" in meshes)
    query, plain, difference, corners = _timed(meshes["planar"], rng, "recast" in meshes)
    return RoomPaths(scene.scene_id, len(rows["placements"]), corners, trajectories, lengths, query, plain, difference)


def _judged(outcome: Outcome, config: NavigationConfig, seconds: float) -> Trajectories:
    """Episodes replayed over the polygons of their navmesh file."""
    import shapely

    episodes: list[Episode] = outcome.rows["episodes"]
    asked = config.train_episodes if outcome.rows["splits"][0].split == "train" else config.test_episodes
    free = _walkable(outcome.blobs[outcome.rows["navmeshes"][0].navmesh_blob])
    off = missed = 0
    for episode in episodes:
        places = replayed(
            episode.actions, np.array(episode.start_position[:2]), episode.start_yaw_radians, config.forward_m, config.motion.turn_radians
        )
        line = shapely.linestrings(places) if len(places) > 1 else shapely.points(places[0])
        off += int(not shapely.covers(free, line))
        views = np.array(episode.view_points)[:, :2]
        missed += int(np.hypot(*(views - places[-1]).T).min() > config.success_m)
    return Trajectories(seconds, asked, len(episodes), sum(len(episode.actions) for episode in episodes), off, missed)


def _walkable(navmesh: bytes) -> shapely.Geometry:
    """What a .navmesh file says is walkable, seen from above, world frame [m], grown by the 0.1 mm that single precision takes."""
    import shapely

    from tasks.navigation.navmesh import read_navmesh

    rings = []
    for tile in read_navmesh(navmesh).tiles:
        for polygon in tile.polygons:
            corners = tile.vertices[polygon["vertices"][: polygon["count"]]].astype(np.float64)
            rings.append(shapely.Polygon(np.column_stack([corners[:, 0], -corners[:, 2]])))
    free = shapely.buffer(shapely.union_all(shapely.buffer(rings, 1e-6)), 1e-4)
    shapely.prepare(free)
    return free


def _pairs(finder: PathFinder, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Random starts and goals, each pair on one island, shape (count, 2) each."""
    areas = np.array(finder.islands)
    islands = rng.choice(len(areas), count, p=areas / areas.sum())
    starts, goals_ = ([finder.random_point(rng, int(island)) for island in islands] for _ in range(2))
    return np.array(starts), np.array(goals_)


def _lengths(navmesh: bytes, rng: np.random.Generator, with_recast: bool) -> dict[str, Array]:
    """Lengths of the same pairs, each on one island of the polygons of one navmesh file [m], where Detour has a path if it is asked.

    There `planar` must have one too: where it has none, its length is infinite and misses the goal.
    """
    from tasks.navigation.navmesh import read_navmesh
    from tasks.navigation.planar import PlanarPathFinder
    from tasks.navigation.recast import RecastPathFinder

    finders: dict[str, PathFinder] = {"planar": PlanarPathFinder.from_navmesh(read_navmesh(navmesh), floor_only=True)}
    if with_recast:
        finders["recast"] = RecastPathFinder(navmesh)
    starts, ends = _pairs(finders["planar"], rng, PAIRS)
    lengths = {
        name: np.array([finder.geodesic(a, b).length for a, b in zip(starts, ends, strict=True)]) for name, finder in finders.items()
    }
    lengths["straight"] = np.hypot(*(ends - starts).T)
    there = np.isfinite(lengths["recast" if with_recast else "planar"])
    return {name: values[there] for name, values in lengths.items()}


def _timed(navmesh: bytes, rng: np.random.Generator, with_recast: bool) -> tuple[dict[str, float], float, float, int]:
    """Seconds per distance by path finder and by the plain graph, their difference [m], and corners of the free polygon.

    What each prepares counts, spread over the pairs that it is asked for.
    """
    import shapely

    from tasks.navigation.navmesh import read_navmesh
    from tasks.navigation.planar import PlanarPathFinder
    from tasks.navigation.recast import RecastPathFinder

    file = read_navmesh(navmesh)
    free = PlanarPathFinder.from_navmesh(file).free
    makers: dict[str, Callable[[], PathFinder]] = {"planar": lambda: PlanarPathFinder(free)}
    if with_recast:
        makers["recast"] = lambda: RecastPathFinder(navmesh)
    starts, ends = _pairs(PlanarPathFinder(free), rng, TIMED_PAIRS)

    def timed(make: Callable[[], Callable[[Array, Array], float]]) -> tuple[float, Array]:
        clock = time.perf_counter()
        distance = make()
        lengths = np.array([distance(a, b) for a, b in zip(starts, ends, strict=True)])
        return (time.perf_counter() - clock) / TIMED_PAIRS, lengths

    def asked(maker: Callable[[], PathFinder]) -> Callable[[Array, Array], float]:
        finder = maker()
        return lambda a, b: finder.geodesic(a, b).length

    times = {name: timed(partial(asked, maker)) for name, maker in makers.items()}
    plain, lengths = timed(lambda: PlainGraph(free).distance)
    difference = float(np.abs(lengths - times["planar"][1]).max())
    return {name: seconds for name, (seconds, _) in times.items()}, plain, difference, len(shapely.get_coordinates(free))


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _ratio(rooms: Sequence[RoomPaths]) -> dict[str, float] | None:
    """Detour's length over the exact one, pairs a centimetre apart or more; None without Recast."""
    if not all("recast" in room.lengths for room in rooms):
        return None
    ratio = np.concatenate([(room.lengths["recast"] / room.lengths["planar"])[room.lengths["straight"] > 0.01] for room in rooms])
    return {"mean": float(ratio.mean()), "p95": float(np.quantile(ratio, 0.95)), "max": float(ratio.max())}


def _episodes(runs: Sequence[Trajectories]) -> dict[str, float | int]:
    return {
        "asked": sum(run.asked for run in runs), "made": sum(run.made for run in runs),
        "seconds_per_100": 100.0 * sum(run.seconds for run in runs) / max(1, sum(run.made for run in runs)),
        "steps_mean": sum(run.steps for run in runs) / max(1, sum(run.made for run in runs)),
        "off": sum(run.off for run in runs), "missed": sum(run.missed for run in runs),
    }  # fmt: skip


def print_navigation(report: Mapping[str, Any], console: Console) -> None:
    """Print the report as tables."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    columns = [("", False), *((name, True) for name in report["episodes"])]
    full = f" ({report['rooms_without_floor']} more leave the agent no floor)" if report["rooms_without_floor"] else ""
    title = f"{report['rooms']} generated rooms{full}, {report['objects']:,} objects, {report['corners_mean']:.0f} corners each"
    table = table_of(title, *columns)
    for words, key, form in (
        ("episodes asked for", "asked", ",.0f"), ("episodes made", "made", ",.0f"), ("actions per episode", "steps_mean", ".1f"),
        ("seconds per 100 episodes, whole stage", "seconds_per_100", ".2f"), ("leave the navmesh in replay", "off", ".0f"),
        ("end farther than 0.2 m from every view point", "missed", ".0f"),
    ):  # fmt: skip
        add_row(table, words, *(format(figures[key], form) for figures in report["episodes"].values()))
    add_row(table, "microseconds per distance", *(f"{report['query_microseconds'][name]:,.0f}" for name in report["episodes"]))
    console.print(table)
    table = table_of("shortest paths", ("", False), ("", True))
    if report["ratio"]:
        for words, key in (("mean", "mean"), ("95th percentile", "p95"), ("greatest", "max")):
            add_row(table, f"Detour's length over the exact one, {words}", f"{report['ratio'][key]:.4f}")
    else:
        add_row(table, "recast is not built here (make native)", "n/a")
    add_row(table, "microseconds per distance by a plain visibility graph", f"{report['plain_microseconds']:,.0f}")
    add_row(table, "planar is so many times faster", f"{report['times_faster_than_plain']:,.0f}")
    add_row(table, "greatest difference of the two [m]", f"{report['plain_difference_m']:.1e}")
    console.print(table)
    console.print(goals_table(report["goals"]))
