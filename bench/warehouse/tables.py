"""The report of the warehouse's benchmark as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.tables import add_row, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console

_GROWTH = {
    "commit_new_seconds": "commit 25 new scenes",
    "commit_new_cpu_seconds": "of it on processors",
    "commit_again_seconds": "commit 25 scenes anew",
    "neighbors_seconds": "replace 200 neighboring scenes of instances",
    "scattered_seconds": "replace 200 scattered scenes of instances",
    "scene_seconds": "open, and read one scene",
    "outline_seconds": "the history in outline, as for the status",
    "outline_cpu_seconds": "of it on processors",
}


def print_warehouse(report: Mapping[str, Any], console: Console) -> None:
    """Print a report."""
    console.print(headline(report["machine"], report["seed"], 2))
    sizes = list(report["lakes"])
    _print_lakes(report, console)
    if "answers" in report:
        _print_answers(report, sizes, console)
    if "volumes" in report:
        _print_volumes(report["volumes"], console)
    if "growth" in report:
        _print_growth(report, sizes, console)
    if "contention" in report:
        _print_contention(report["contention"], console)
    if "refusals" in report:
        _print_refusals(report, console)
    console.print(goals_table(report["goals"]))


def _print_lakes(report: Mapping[str, Any], console: Console) -> None:
    table = table_of("generated lakes", ("scenes", True), ("objects", True), ("rows", True), ("files", True), ("GB", True))
    for scenes, lake in report["lakes"].items():
        cells = (lake["rows"]["captions"], lake["all_rows"], sum(lake["files"].values()))
        add_row(table, f"{int(scenes):,}", *(f"{cell:,}" for cell in cells), f"{lake['all_bytes'] / 1e9:.2f}")
    console.print(table)


def _print_answers(report: Mapping[str, Any], sizes: list[str], console: Console) -> None:
    """One line per question, slowest first: median seconds by lake, then the first run and processor time of the largest."""
    headers = [(f"{int(scenes):,}", True) for scenes in sizes]
    title = "questions of the report: median seconds by scenes of the lake; first run on cold files, processor time and rows of the largest"
    table = table_of(title, ("", False), *headers, ("first", True), ("processor", True), ("rows", True))
    by_size = {scenes: {answer["name"]: answer for answer in report["answers"][scenes]["answers"]} for scenes in sizes}
    largest = by_size[sizes[-1]]
    for name in sorted(largest, key=lambda name: -largest[name]["seconds"]):
        cells = [f"{by_size[scenes][name]['seconds']:.3f}" if name in by_size[scenes] else "-" for scenes in sizes]
        answer = largest[name]
        add_row(table, name, *cells, f"{answer['first_seconds']:.3f}", f"{answer['cpu_seconds']:.3f}", f"{answer['rows']:,}")
    add_row(table, "open, with all views", *[f"{report['answers'][scenes]['connect_seconds']:.3f}" for scenes in sizes], "", "", "")
    add_row(table, "memory at most, MB", *[f"{report['answers'][scenes]['peak_memory_mb']:,.0f}" for scenes in sizes], "", "", "")
    console.print(table)


def _print_volumes(volumes: Mapping[str, Any], console: Console) -> None:
    table = table_of("box plot of volumes, 50 categories", ("", False), ("seconds", True), ("first run", True), ("differences", True))
    lines = {"lake": "the lake", "sorted": "one file sorted by category and volume", "by_key": "one file sorted by scene and object"}
    for name, text in lines.items():
        figures = volumes[name]
        add_row(table, text, f"{figures['seconds']:.3f}", f"{figures['first_seconds']:.3f}", str(volumes["differences"].get(name, "")))
    add_row(table, "pandas", f"{volumes['pandas_seconds']:.3f}", "", str(volumes["differences"]["pandas"]))
    console.print(table)


def _print_growth(report: Mapping[str, Any], sizes: list[str], console: Console) -> None:
    table = table_of("changes: median seconds by scenes of the lake", ("", False), *[(f"{int(scenes):,}", True) for scenes in sizes])
    for name, text in _GROWTH.items():
        add_row(table, text, *[f"{figure[name]:.3f}" for figure in report["growth"]])
    console.print(table)


def _print_contention(seen: Mapping[str, Any], console: Console) -> None:
    console.print(
        f"contention: {seen['writers']} processes stage {seen['scenes']} scenes twice, {seen['committers']} compete to commit them: "
        f"{seen['commits']} commits in {seen['seconds']:.1f} s, {seen['kills']} committers killed, {seen['in_commit']} of them in "
        f"mid-commit, {seen['reads']} snapshots read meanwhile; {len(seen['errors'])} errors, {seen['halves']} scenes seen in part, "
        f"{seen['mixed']} of two ages, {seen['lost']} rows lost, {seen['doubled']} doubled",
        markup=False,
    )


def _print_refusals(report: Mapping[str, Any], console: Console) -> None:
    table = table_of("attempts", ("", False), ("tried", True), ("refused", True), ("changed something", True))
    kinds = dict.fromkeys(attempt["kind"] for attempt in report["refusals"])
    for kind in kinds:
        own = [attempt for attempt in report["refusals"] if attempt["kind"] == kind]
        add_row(
            table,
            kind,
            str(len(own)),
            str(sum(attempt["refused"] for attempt in own)),
            str(sum(not attempt["unchanged"] for attempt in own)),
        )
    console.print(table)
    for attempt in report["refusals"]:
        if not attempt["refused"] or not attempt["unchanged"]:
            console.print(f"  {attempt['kind']}: {attempt['tried']}: {attempt['message'] or 'nothing was said'}", markup=False)
