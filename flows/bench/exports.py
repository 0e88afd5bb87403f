"""The benchmark of the exports: generated rooms in every format, held against the gates and against their certificates."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flows.bench.goals import goal
from flows.bench.gravity import Unstable, certified_unstable, farthest_apart, left_alone, unstable_of
from flows.bench.machine import machine
from flows.bench.replicas import as_replica
from flows.bench.rooms import generated_scene
from flows.bench.tables import add_row, goals_table, headline, table_of
from flows.pool import WorkerPool
from schemas.exports import FORMATS
from tasks import exports
from tasks.exports import ExportsConfig
from tasks.navigation import NavigationConfig
from tasks.optimization.mujoco_engine import mujoco_module
from tasks.stage import Context

if TYPE_CHECKING:
    from rich.console import Console

SECONDS = 2.0
"""Simulated time of certificates [s]."""

READERS = ("mjcf", "usd")
"""Formats that are simulated."""


@dataclasses.dataclass(frozen=True)
class ExportsBench:
    """What is measured. episodes: per room, so that the gates have some to replay."""

    rooms: int = 20
    seed: int = 0
    processes: int = 1
    episodes: int = 20


@dataclasses.dataclass(frozen=True)
class RoomExports:
    """One room: seconds, bytes and files by format, broken rules, and what is unstable by certificate and by file."""

    scene_id: str
    things: int
    seconds: Mapping[str, float]
    sizes: Mapping[str, int]
    files: Mapping[str, int]
    rules: int
    broken: tuple[tuple[str, str, str], ...]
    unstable: Mapping[str, Unstable]
    largest_difference_m: Mapping[str, float]


def run_exports_bench(config: ExportsBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report: figures by format, goals, what is broken or differs. `advance` is told each room that is done."""
    with WorkerPool(config.processes) as pool, ThreadPoolExecutor(config.processes) as threads:
        made: list[RoomExports] = []
        for room in threads.map(partial(pool.call, measure_room, config), range(config.rooms)):
            advance(room.scene_id)
            made.append(room)
    formats = {
        name: {
            "seconds_mean": float(np.mean([room.seconds[name] for room in made])),
            "megabytes_mean": float(np.mean([room.sizes[name] for room in made])) / 1e6,
            "files_mean": float(np.mean([room.files[name] for room in made])),
            "scenes_passed": sum(all(format_ != name for format_, _, _ in room.broken) for room in made),
        }
        for name in FORMATS
    }  # fmt: skip
    return {
        "machine": machine(), "seed": config.seed, "processes": config.processes, "rooms": len(made),
        "things": sum(room.things for room in made), "formats": formats,
        "broken": [[room.scene_id, *line] for room in made for line in room.broken],
        "certified": _unstable(made, "certificate"), "simulated": {name: _compared(made, name) for name in READERS},
        "goals": goals(made),
    }  # fmt: skip


def goals(rooms: Sequence[RoomExports]) -> list[dict[str, Any]]:
    """Every scene passes every gate, and what the files make unstable is what the certificates say."""
    exported = len(rooms) * len(FORMATS)
    broken = {(room.scene_id, format_) for room in rooms for format_, _, _ in room.broken}
    found = [goal("exports that pass their gate [%]", 100.0 * (exported - len(broken)) / exported if exported else None, ">=", 100.0)]
    for name in READERS:
        compared = _compared(rooms, name)
        found += [
            goal(f"free things that {name} and certificate judge otherwise at {limit}", len(compared[f"differ_{key}"]), "<=", 0)
            for key, limit in (("1cm", "1 cm"), ("5cm", "5 cm and 5 degrees"))
        ]
    return found


def measure_room(config: ExportsBench, index: int) -> RoomExports:
    """One room through optimization, navigation and every export. Runs in a worker."""
    caches: Any = defaultdict(dict)
    scene = generated_scene(index, config.rooms, config.seed)
    navigation = NavigationConfig(train_episodes=config.episodes, test_episodes=config.episodes)
    rows, blobs, seconds = as_replica(scene, config.seed, caches, navigation)
    sizes, files, broken, rules = {}, {}, [], 0
    unstable = {"certificate": certified_unstable(rows["certificates"])}
    difference: dict[str, float] = {}
    for format_ in FORMATS:
        context = Context(scene.scene_id, "exports", config.seed, blobs, caches)
        clock = time.perf_counter()
        outcome = exports.run(
            **{table: rows[table] for table in exports.STAGE.reads}, context=context, config=ExportsConfig(formats=(format_,))
        )
        seconds[format_] = time.perf_counter() - clock
        made = outcome.rows["export_files"]
        sizes[format_], files[format_] = sum(row.size_bytes for row in made), len(made)
        rules += len(outcome.rows["export_checks"])
        broken += [(row.format, row.rule, row.message or "") for row in outcome.rows["export_checks"] if not row.passed]
        if format_ in READERS:
            with tempfile.TemporaryDirectory(prefix="bench-") as place:
                exports.write_folder(Path(place), {row.path: outcome.blobs[row.file_blob] for row in made})
                model = _model(format_, Path(place))
                settled = left_alone(model, SECONDS)
                unstable[format_] = unstable_of(settled)
                difference[format_] = farthest_apart(settled, rows["certificates"])
    return RoomExports(scene.scene_id, len(rows["placements"]), seconds, sizes, files, rules, tuple(broken), unstable, difference)


def _model(format_: str, root: Path) -> Any:
    """The MuJoCo model of the one scene below a folder, by its files."""
    mujoco = mujoco_module()

    if format_ == "mjcf":
        return mujoco.MjModel.from_xml_path(str(next(root.rglob("scene.xml"))))
    from flows.bench import usd_reader

    return usd_reader.model_of(next(root.rglob("scene.usda")))


def _unstable(rooms: Sequence[RoomExports], source: str) -> dict[str, list[str]]:
    """Unstable things of all rooms as `<scene>/<instance>`."""
    return {
        f"unstable_{limit}": sorted(f"{room.scene_id}/{name}" for room in rooms for name in getattr(room.unstable[source], f"at_{limit}"))
        for limit in ("1cm", "5cm")
    }  # fmt: skip


def _compared(rooms: Sequence[RoomExports], name: str) -> dict[str, Any]:
    """What files in a format make unstable, and what certificates judge otherwise."""
    found, certified = _unstable(rooms, name), _unstable(rooms, "certificate")
    differ = {f"differ_{limit}": sorted({*found[f"unstable_{limit}"]} ^ {*certified[f"unstable_{limit}"]}) for limit in ("1cm", "5cm")}
    return {**found, **differ, "largest_difference_m": max((room.largest_difference_m[name] for room in rooms), default=0.0)}


def print_exports(report: Mapping[str, Any], console: Console) -> None:
    """Print the report as tables."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    table = table_of(
        f"{report['rooms']} generated rooms, {report['things']:,} things", ("format", False), ("scenes that pass", True),
        ("seconds per scene", True), ("MB per scene", True), ("files per scene", True),
    )  # fmt: skip
    for name, found in report["formats"].items():
        figures = (f"{found['seconds_mean']:.2f}", f"{found['megabytes_mean']:.2f}", f"{found['files_mean']:.0f}")
        add_row(table, name, f"{found['scenes_passed']} of {report['rooms']}", *figures)
    console.print(table)
    table = table_of(
        f"left alone for {SECONDS:g} s", ("read from", False), ("unstable at 1 cm", True), ("unstable at 5 cm, 5 degrees", True),
        ("judged otherwise", True), ("ends apart by at most", True),
    )  # fmt: skip
    add_row(table, "certificates", *(str(len(report["certified"][key])) for key in ("unstable_1cm", "unstable_5cm")), "", "")
    for name, found in report["simulated"].items():
        differ = len({*found["differ_1cm"], *found["differ_5cm"]})
        counts = (str(len(found["unstable_1cm"])), str(len(found["unstable_5cm"])), str(differ))
        add_row(table, name, *counts, f"{1000 * found['largest_difference_m']:.3g} mm")
    console.print(table)
    if report["broken"]:
        table = table_of("broken rules", ("scene", False), ("format", False), ("rule", False), ("", False))
        for line in report["broken"]:
            add_row(table, *line)
        console.print(table)
    console.print(goals_table(report["goals"]))
