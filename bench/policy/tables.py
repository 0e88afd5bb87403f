"""The report of policies as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.policy.datasets import HOME
from bench.policy.frames import frames_table
from bench.policy.report import COMPARED, FRAMES, KILLED, LOOP, STEPS
from bench.tables import add_row, as_text, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console


def print_policy(report: Mapping[str, Any], console: Console) -> None:
    """Print the parts that were measured, and all goals."""
    console.print(headline(report["machine"], report["seed"], report["processes"]))
    parts = report["parts"]
    if FRAMES in parts:
        console.print(frames_table(parts[FRAMES]))
    if STEPS in parts:
        console.print(_steps(parts[STEPS]))
    if LOOP in parts:
        _print_loop(parts[LOOP], console)
    if COMPARED in parts:
        _print_compared(parts[COMPARED], console)
    if KILLED in parts:
        killed = parts[KILLED]
        console.print(
            f"killed: {killed['trainings_killed']} times a training, {killed['evaluations_killed']} times an evaluation of "
            f"{killed['trajectories']} trajectories in {killed['rooms']} rooms",
            markup=False,
            soft_wrap=True,
        )
    console.print(goals_table(report["goals"]))


def _steps(report: Mapping[str, Any]) -> Any:
    """Steps per CPU second."""
    title = f"steps of an agent per CPU second, {report['agents']} agents in {report['scenes']} rooms of {report['objects']} objects"
    table = table_of(title, ("", False), *((f"{size} px", True) for size in report["sizes"]))
    for name in ("batched", "copied", "single"):
        rates = report[name]
        add_row(table, name, *(as_text(round(rates[str(size)]), "") if str(size) in rates else "" for size in report["sizes"]))
    return table


def _print_loop(loop: Mapping[str, Any], console: Console) -> None:
    """How well policies do in held-out rooms, how often they know the right action there, and what trainings took."""
    rooms, episodes = loop["rooms"], loop["episodes"]
    console.print(
        f"learned from {episodes['train']:,} episodes in {rooms['train']} rooms; let go in {episodes['test']:,} episodes in "
        f"{rooms['test']} held-out rooms; found: stopped by itself within 1 m with the target in view; intervals are Wilson's, 95 %, of "
        "all seeds together",
        markup=False,
        soft_wrap=True,
    )
    table = table_of(
        "targets found [%]", ("", False), ("seeds", True), ("found", True), ("by seed", True), ("in view at start", True), ("of", True),
        ("within 1 m", True), ("within 0.1 m", True), ("stopped", True),
    )  # fmt: skip
    for name, row in loop["figures"].items():
        add_row(
            table, name, str(row["seeds"]), _share(row, "found"), ", ".join(_percent(value) for value in row["by_seed"]),
            _share(row, "found_in_view"), f"{row['in_view_count']:,} / {row['n']:,}", _percent(row["success"]), _percent(row["arrived"]),
            _percent(row["stopped"]),
        )  # fmt: skip
    console.print(table)
    table = table_of(
        "ways; SPL of those found, SEL of those within 1 m", ("", False), ("SPL [%]", True), ("SEL [%]", True), ("EL", True),
        ("EL, success", True), ("curvature [rad/m]", True), ("collisions", True),
    )  # fmt: skip
    for name, row in loop["figures"].items():
        numbers = ("n/a" if row[key] is None else f"{row[key]:.{digits}f}" for key, digits in _DIGITS)
        add_row(table, name, _percent(row["found_spl"]), _percent(row["sel"]), *numbers)
    console.print(table)
    console.print(_trainings(loop))
    for line in loop["failed"]:
        console.print(f"failed: {line}", markup=False, soft_wrap=True)


def _print_compared(compared: Mapping[str, Any], console: Console) -> None:
    """How well policies do that learned from one dataset or another, and the tests of pairs."""
    if "missing" in compared:
        console.print(f"not compared: {compared['missing']}", markup=False, soft_wrap=True)
        return
    scenes = ", ".join(f"{compared['rooms'][name]} with {count:,} episodes of {name}" for name, count in compared["episodes"].items())
    console.print(f"scenes: {scenes}", markup=False, soft_wrap=True)
    near_m = compared["rows"][0]["success_distance_m"] if compared["rows"] else 0.0
    table = table_of(
        f"in the same episodes of {HOME}, by what was learned from; success: stopped within {near_m:g} m of a view point", ("", False),
        ("seeds", True), ("n", True), ("SR [%]", True), ("of seeds", True), ("at 1 m in view [%]", True), ("EL", True),
        ("curvature [rad/m]", True), ("SEL [%]", True), ("SPL [%]", True),
    )  # fmt: skip
    for row in compared["rows"]:
        add_row(
            table, row["trained_on"], str(row["seeds"]), f"{row['n']:,}",
            f"{_percent(row['sr'])} ({_percent(row['sr_low'])}-{_percent(row['sr_high'])})",
            f"{_percent(row['least_sr'])}-{_percent(row['greatest_sr'])}", _percent(row["found_share"]), f"{row['el']:.1f}",
            _number(row["curvature_turning_angle_per_m"], 2), _percent(row["sel"]), _percent(row["spl"]),
        )  # fmt: skip
    console.print(table)
    table = table_of(
        "pairs: p of these models in such episodes, p by seed of other trainings on the same datasets", ("first", False),
        ("second", False), ("measure", False), ("pairs", True), ("difference [points]", True), ("p", True),
        ("p by seed", True),
    )  # fmt: skip
    for test in compared["tests"]:
        add_row(
            table, test["first"], test["second"], test["measure"], f"{test['pairs']:,}", f"{100 * test['difference']:+.1f}",
            _number(test["p_value"], 4), _number(test["p_value_by_seed"], 2),
        )  # fmt: skip
    console.print(table)
    for line in (*compared["notes"], *(f"failed: {line}" for line in compared["failed"])):
        console.print(line, markup=False, soft_wrap=True)


def _number(value: float | None, digits: int) -> str:
    return "n/a" if value is None else f"{value:.{digits}f}"


_DIGITS = (("el", 1), ("el_success", 1), ("curvature", 2), ("collisions", 1))


def _trainings(loop: Mapping[str, Any]) -> Any:
    table = table_of(
        "trainings", ("", False), ("seeds", True), ("parameters", True), ("minutes", True), ("device", False), ("right actions [%]", True),
        ("most frequent action [%]", True),
    )  # fmt: skip
    for name in dict.fromkeys(row["name"] for row in loop["trainings"]):
        own = [row for row in loop["trainings"] if row["name"] == name]
        minutes = [row["seconds"] / 60 for row in own]
        spread = f"{sum(minutes) / len(own):.1f} ({min(minutes):.1f}-{max(minutes):.1f})"
        known = loop["accuracy"].get(name)
        right = "n/a" if known is None else f"{100 * known['accuracy']:.1f} ({100 * known['low']:.1f}-{100 * known['high']:.1f})"
        add_row(
            table, name, str(len(own)), f"{own[0]['parameters']:,}", spread,
            own[0]["device"], right, _percent(None if known is None else known["majority"]),
        )  # fmt: skip
    return table


def _share(row: Mapping[str, Any], key: str) -> str:
    """A share with its interval [%]."""
    interval = row[f"{key}_interval"]
    return "n/a" if interval is None else f"{_percent(row[key])} ({_percent(interval['low'])}-{_percent(interval['high'])})"


def _percent(share: float | None) -> str:
    return "n/a" if share is None else f"{100 * share:.1f}"
