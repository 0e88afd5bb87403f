"""The report of the flows' benchmark as tables for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bench.flows.report import added_share, real_share
from bench.flows.requests import KINDS
from bench.flows.runs import PLAIN
from bench.flows.scale import BESIDE
from bench.tables import add_row, as_text, goals_table, headline, table_of
from schemas.wording import noun

if TYPE_CHECKING:
    from rich.console import Console


def print_flows(report: Mapping[str, Any], console: Console) -> None:
    """Print a report."""
    console.print(headline(report["machine"], report["seed"], report["workers"]))
    if "startup" in report:
        table = table_of("before the first stage", ("", False), ("seconds", True))
        for name, seconds in report["startup"].items():
            add_row(table, name, f"{seconds:.2f}")
        console.print(table)
    if "overhead" in report:
        _print_overhead(report, console)
        _print_memory(report, console)
    if "scene" in report:
        _print_scene(report["scene"], console)
    if "speed" in report:
        _print_speed(report, console)
    if "sharing" in report:
        _print_sharing(report["sharing"], console)
    if "chaos" in report:
        _print_chaos(report["chaos"], console)
    console.print(goals_table(report["goals"]))


def print_scale(report: Mapping[str, Any], console: Console) -> None:
    """Print what grows with objects and with scenes."""
    console.print(headline(report["machine"], report["seed"], 1))
    for what, title in (("objects", "one scene with so many objects"), ("scenes", "so many near-empty scenes")):
        sizes, powers = report[what]["sizes"], report[what]["exponents"]
        columns = [(f"{size['size']:,}: cpu s", True) for size in sizes] + [(f"{size['size']:,}: MB", True) for size in sizes]
        table = table_of(f"{title}: processor seconds, most memory, power of the size", ("stage", False), *columns, ("power", True))
        for name in sizes[-1]["stages"]:
            parts = [size["stages"].get(name, {"cpu_seconds": 0.0, "memory_mb": 0.0}) for size in sizes]
            power = f"{powers[name]:.2f}" if name in powers else ""
            add_row(table, name, *(f"{p['cpu_seconds']:.2f}" for p in parts), *(f"{p['memory_mb']:.0f}" for p in parts), power)
        console.print(table)
        _print_bytes(sizes, console)
    for size in report["requests"]:
        columns = [(kind, True) for kind in KINDS]
        table = table_of(f"requests to a store of objects, {size['size']:,} near-empty scenes", ("stage", False), *columns)
        for name, part in size["stages"].items():
            add_row(table, name, *(f"{part['requests'][kind]:,}" for kind in KINDS))
        console.print(table)
    if report["held"]:
        _print_held(report["held"], console)
    if "projection" in report:
        _print_projection(report["projection"], console)
    for size in report["steep"]:
        console.print(f"grows faster than linearly: {size}", markup=False)
    console.print(goals_table(report["goals"]))


def _print_held(sizes: Sequence[Mapping[str, Any]], console: Console) -> None:
    columns = [(f"beside {size['size']:,}: cpu s", True) for size in sizes] + [(f"beside {size['size']:,}: MB", True) for size in sizes]
    title = f"{BESIDE} near-empty scenes in a lake that holds so many others: processor seconds, most memory"
    table = table_of(title, ("stage", False), *columns)
    for name in sizes[-1]["stages"]:
        parts = [size["stages"][name] for size in sizes]
        add_row(table, name, *(f"{part['cpu_seconds']:.2f}" for part in parts), *(f"{part['memory_mb']:.0f}" for part in parts))
    console.print(table)


def _print_projection(seen: Mapping[str, float], console: Console) -> None:
    table = table_of(f"{seen['scenes']:,} such scenes", ("what", False), ("amount", True))
    add_row(table, "days of one core", f"{seen['core_hours'] / 24:,.1f}")
    add_row(table, "GB in the lake", f"{seen['bytes'] / 1e9:,.1f}")
    for kind in KINDS:
        add_row(table, f"million requests: {kind}", f"{seen[kind] / 1e6:,.1f}")
    for name, what in (("core_usd", "processors"), ("requests_usd", "requests"), ("month_usd", "bytes, a month")):
        add_row(table, f"USD: {what}", f"{seen[name]:,.0f}")
    console.print(table)


def _print_bytes(sizes: Sequence[Mapping[str, Any]], console: Console) -> None:
    table = table_of(
        "bytes in the lake: rows and blobs of a stage; files", ("stage", False), *((f"{size['size']:,}", True) for size in sizes)
    )
    for name in sizes[-1]["holds"]["bytes"]:
        add_row(table, name, *(f"{size['holds']['bytes'].get(name, 0):,}" for size in sizes))
    add_row(table, "files", *(f"{size['holds']['files']:,}" for size in sizes))
    console.print(table)


def _print_overhead(report: Mapping[str, Any], console: Console) -> None:
    real = report["real"]
    mean = real["stage_seconds"] / real["stage_runs"]
    title = (
        f"overhead per stage run: its share of these small scenes' run; what of it a plain loop over the pool ({PLAIN}) does not need; and "
        f"its share when a stage takes {mean:.2f} s, as in a generated room of 25 objects; {report['workers']} workers; "
        "main: processor time of the coordinator"
    )
    table = table_of(title, ("scenes", True), ("runner", False), ("start s", True), ("work s", True), ("end s", True), ("stage ms", True),
                     ("overhead ms", True), ("share", True), ("added", True), ("real share", True), ("main s", True),
                     ("load", True))  # fmt: skip
    for figure in report["overhead"]:
        added = "" if figure["runner"] == PLAIN else as_text(added_share(figure, report["overhead"]), "percent")
        add_row(
            table, f"{figure['scenes']:,}", figure["runner"], f"{figure['startup_seconds']:.1f}", f"{figure['work_seconds']:.1f}",
            f"{figure['ending_seconds']:.1f}", f"{1000 * figure['stage_seconds'] / figure['stage_runs']:.0f}",
            f"{1000 * figure['overhead_seconds']:.1f}", as_text(figure["share"], "percent"), added,
            as_text(real_share(figure, real), "percent"),
            f"{figure['cpu_seconds']:.1f}", f"{figure['load']:.1f}",
        )  # fmt: skip
    console.print(table)


def _print_memory(report: Mapping[str, Any], console: Console) -> None:
    table = table_of("memory [MB]", ("scenes", True), ("runner", False), ("coordinator at most", True), ("growth per 1,000 scenes", True),
                     ("its children at most", True))  # fmt: skip
    for figure in report["overhead"]:
        workers = max((sample[2] for sample in figure["samples"]), default=0.0)
        growth = "n/a" if figure["growth_mb"] is None else f"{figure['growth_mb']:.0f}"
        add_row(table, f"{figure['scenes']:,}", figure["runner"], f"{figure['peak_memory_mb']:.0f}", growth, f"{workers:,.0f}")
    console.print(table)


def _print_scene(scenes: Sequence[Mapping[str, Any]], console: Console) -> None:
    columns = [(f"{scene['objects']} objects, {scene['cores']} {noun(scene['cores'], 'core')}", True) for scene in scenes]
    table = table_of("one scanned room after another went through: seconds of the clock", ("stage", False), *columns)
    for stage in scenes[-1]["seconds"]:
        add_row(table, stage, *(f"{scene['seconds'][stage]:.2f}" for scene in scenes))
    add_row(table, "all", *(f"{sum(scene['seconds'].values()):.1f}" for scene in scenes))
    console.print(table)


def _print_speed(report: Mapping[str, Any], console: Console) -> None:
    for what, runs in (("small scenes", report["speed"]), ("rooms of about 25 objects", report["room_speed"])):
        table = table_of(f"one worker on one core and two, {what}", ("scenes", True), ("workers", True), ("work s", True),
                         ("whole run s", True), ("between stages", True), ("at its ends", True), ("main cpu s", True),
                         ("others cpu s", True), ("load", True))  # fmt: skip
        for run in runs:
            of_workers = run["work_seconds"] * run["workers"]
            add_row(
                table, f"{run['scenes']:,}", str(run["workers"]), f"{run['work_seconds']:.1f}", f"{run['seconds']:.1f}",
                as_text(run["between_seconds"] / of_workers, "percent"), as_text(run["edge_seconds"] / of_workers, "percent"),
                f"{run['cpu_seconds']:.1f}", f"{run['others_cpu_seconds']:.1f}", f"{run['load']:.1f}",
            )  # fmt: skip
        console.print(table)


def _print_sharing(seen: Mapping[str, Any], console: Console) -> None:
    console.print(
        f"two runs at once over {seen['scenes']} scenes, {seen['overlap']} of them both runs': exit codes {_listed(seen['codes'])} after "
        f"{seen['seconds']:.1f} s; they computed {_listed(seen['computed'])} scenes and left {_listed(seen['shared'])} to each other; "
        f"{len(seen['both'])} were computed by both, {len(seen['neither'])} by neither",
        markup=False,
    )
    _print_faults(seen["verdict"], console)


def _print_chaos(seen: Mapping[str, Any], console: Console) -> None:
    kinds: dict[str, int] = {}
    for kill in seen["kills"]:
        kinds[kill["what"]] = kinds.get(kill["what"], 0) + 1
    console.print(
        f"chaos: {len(seen['kills'])} kills ({', '.join(f'{count} {what}' for what, count in sorted(kinds.items()))}) in a run of "
        f"{seen['scenes']} scenes; the command was given {len(seen['codes'])} times within {seen['seconds']:.0f} s, exit codes "
        f"{_listed(seen['codes'])}; {len(seen['lost'])} stage runs lost their worker, {len(seen['unsaid'])} of them unsaid; "
        f"{len(seen['redone'])} finished stages were done again",
        markup=False,
    )
    _print_faults(seen["verdict"], console)


def _print_faults(verdict: Mapping[str, Any], console: Console) -> None:
    """What is wrong with the lake, a line each; nothing where nothing is."""
    for kind, faults in verdict.items():
        for line in faults:
            console.print(f"  {kind.replace('_', ' ')}: {line}", markup=False)


def _listed(values: Any) -> str:
    return ", ".join(map(str, values))
