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

from bench.disorder import certificates_of, in_disorder
from bench.goals import goal
from bench.gravity import Settled, Unstable, certified_unstable, farthest_apart, instance_of, left_alone, unstable_of
from bench.machine import machine
from bench.replicas import as_replica
from bench.rooms import generated_scene
from bench.tables import add_row, goals_table, headline, table_of
from flows.run.pool import WorkerPool
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.optimization import Certificate
from tasks import exports
from tasks.exports import ExportsConfig
from tasks.exports.bodies import Replica, gather
from tasks.exports.mjcf import mjcf_files
from tasks.exports.usd import write_usd
from tasks.navigation import NavigationConfig
from tasks.optimization.engines.mujoco_engine import mujoco_module
from tasks.stage import Context

if TYPE_CHECKING:
    from rich.console import Console

SECONDS = 2.0
"""Simulated time of certificates [s]."""

READERS = ("mjcf", "usd")
"""Formats that are simulated."""

STATES = ("as optimized", "in disorder")
"""Rooms are simulated as they are exported, and again with every fourth free object lifted or tilted."""


@dataclasses.dataclass(frozen=True)
class ExportsBench:
    """What is measured. episodes: per room, so that the gates have some to replay."""

    rooms: int = 20
    seed: int = 0
    processes: int = 1
    episodes: int = 20


@dataclasses.dataclass(frozen=True)
class Falls:
    """What moves when a room is left alone: by its certificates, and by format as its files say.

    apart: Greatest distance between where an object ends by a file and by its certificate [m], by format, of objects that are
    stable: where what falls ends is chance.
    """

    certified: Unstable
    read: Mapping[str, Unstable]
    apart: Mapping[str, float]


@dataclasses.dataclass(frozen=True)
class RoomExports:
    """One room: seconds, bytes and files by format, broken rules, and what falls in the states `STATES` of it."""

    scene_id: str
    objects: int
    seconds: Mapping[str, float]
    sizes: Mapping[str, int]
    files: Mapping[str, int]
    rules: int
    broken: tuple[tuple[str, str, str], ...]
    states: Mapping[str, Falls]


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
        for name in EXPORT_FORMATS
    }  # fmt: skip
    return {
        "machine": machine(), "seed": config.seed, "processes": config.processes, "rooms": len(made),
        "objects": sum(room.objects for room in made), "formats": formats,
        "broken": [[room.scene_id, *line] for room in made for line in room.broken],
        "states": {state: _fallen(made, state) for state in STATES},
        "goals": goals(made),
    }  # fmt: skip


def goals(rooms: Sequence[RoomExports]) -> list[dict[str, Any]]:
    """Every scene passes every gate, and what the files make unstable is what the certificates say."""
    exported = len(rooms) * len(EXPORT_FORMATS)
    broken = {(room.scene_id, format_) for room in rooms for format_, _, _ in room.broken}
    rows = [goal("exports that pass their gate [%]", 100.0 * (exported - len(broken)) / exported if exported else None, ">=", 100.0)]
    for state in STATES:
        fallen = _fallen(rooms, state)
        rows += [
            goal(
                f"free objects {state} that {name} and certificate judge otherwise at {limit}", len(fallen[name][f"differ_{key}"]), "<=", 0
            )
            for name in READERS
            for key, limit in (("1cm", "1 cm"), ("5cm", "5 cm and 5 degrees"))
        ]
    return rows


def measure_room(config: ExportsBench, index: int) -> RoomExports:
    """One room through optimization, navigation and every export. Runs in a worker."""
    caches: Any = defaultdict(dict)
    scene = generated_scene(index, config.rooms, config.seed)
    navigation = NavigationConfig(train_episodes=config.episodes, test_episodes=config.episodes)
    rows, blobs, seconds = as_replica(scene, config.seed, caches, navigation)
    sizes, files, broken, rules = {}, {}, [], 0
    settled: dict[str, dict[str, Settled]] = {}
    for format_ in EXPORT_FORMATS:
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
                settled[format_] = left_alone(_model(format_, Path(place)), SECONDS)
    as_placed = _compared(rows["certificates"], settled)
    config_ = ExportsConfig()
    replica = in_disorder(_replica(rows, blobs, config_, caches), np.random.default_rng([config.seed, index]))
    with tempfile.TemporaryDirectory(prefix="bench-") as place:
        write_usd(Path(place) / "usd", replica, config_)
        exports.write_folder(Path(place) / "mjcf", {file.path: file.data for file in mjcf_files(replica, config_)})
        thrown = {format_: left_alone(_model(format_, Path(place) / format_), SECONDS) for format_ in READERS}
    states = {"as optimized": as_placed, "in disorder": _compared(certificates_of(replica), thrown)}
    return RoomExports(scene.scene_id, len(rows["placements"]), seconds, sizes, files, rules, tuple(broken), states)


def _model(format_: str, root: Path) -> Any:
    """The MuJoCo model of the one scene below a folder, by its files."""
    mujoco = mujoco_module()

    if format_ == "mjcf":
        return mujoco.MjModel.from_xml_path(str(next(root.rglob("scene.xml"))))
    from bench import usd_reader

    return usd_reader.model_of(next(root.rglob("scene.usda")))


def _replica(rows: Mapping[str, list[Any]], blobs: Mapping[str, bytes], config: ExportsConfig, caches: Any) -> Replica:
    """The replica that the exports are made of."""
    tables = ("scenes", "shells", "instances", "captions", "assets", "placements", "supports")
    return gather(*(rows[table] for table in tables), blobs, config, caches["tasks.geometry.pieces"])[0]  # type: ignore[call-arg, arg-type]


def _compared(certificates: Sequence[Certificate], settled: Mapping[str, Mapping[str, Settled]]) -> Falls:
    """What files make of a room, held against its certificates."""
    certified = certified_unstable(certificates)
    moved = certified.at_1cm | certified.at_5cm
    apart = {
        name: farthest_apart({body: pose for body, pose in poses.items() if instance_of(body) not in moved}, certificates)
        for name, poses in settled.items()
    }  # fmt: skip
    return Falls(certified, {name: unstable_of(poses) for name, poses in settled.items()}, apart)


def _fallen(rooms: Sequence[RoomExports], state: str) -> dict[str, Any]:
    """What is unstable in a state over all rooms, by certificates and by format; objects as `<scene>/<instance>`."""

    def objects(key: str, of: Callable[[Falls], Unstable]) -> set[str]:
        return {f"{room.scene_id}/{name}" for room in rooms for name in getattr(of(room.states[state]), f"at_{key}")}

    certified = {key: objects(key, lambda falls: falls.certified) for key in ("1cm", "5cm")}
    report: dict[str, Any] = {"certificates": {f"unstable_{key}": sorted(certified[key]) for key in certified}}
    for name in READERS:
        read = {key: objects(key, lambda falls, name=name: falls.read[name]) for key in certified}  # type: ignore[misc]
        report[name] = {f"unstable_{key}": sorted(read[key]) for key in read}
        report[name] |= {f"differ_{key}": sorted(read[key] ^ certified[key]) for key in read}
        report[name]["apart_m"] = max((room.states[state].apart[name] for room in rooms), default=0.0)
    return report


def print_exports(report: Mapping[str, Any], console: Console) -> None:
    """Print the report as tables."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    table = table_of(
        f"{report['rooms']} generated rooms, {report['objects']:,} objects", ("format", False), ("scenes that pass", True),
        ("seconds per scene", True), ("MB per scene", True), ("files per scene", True),
    )  # fmt: skip
    for name, numbers in report["formats"].items():
        figures = (f"{numbers['seconds_mean']:.2f}", f"{numbers['megabytes_mean']:.2f}", f"{numbers['files_mean']:.0f}")
        add_row(table, name, f"{numbers['scenes_passed']} of {report['rooms']}", *figures)
    console.print(table)
    for state, numbers in report["states"].items():
        table = table_of(
            f"{state}, left alone for {SECONDS:g} s", ("read from", False), ("unstable at 1 cm", True), ("at 5 cm, 5 degrees", True),
            ("judged otherwise", True), ("stable ones end apart by", True),
        )  # fmt: skip
        for name, faults in numbers.items():
            counts = [str(len(faults[f"unstable_{key}"])) for key in ("1cm", "5cm")]
            if name in READERS:
                counts += [str(len({*faults["differ_1cm"], *faults["differ_5cm"]})), f"{1000 * faults['apart_m']:.3g} mm"]
            add_row(table, name, *counts, *[""] * (4 - len(counts)))
        console.print(table)
    if report["broken"]:
        table = table_of("broken rules", ("scene", False), ("format", False), ("rule", False), ("", False))
        for line in report["broken"]:
            add_row(table, *line)
        console.print(table)
    console.print(goals_table(report["goals"]))
