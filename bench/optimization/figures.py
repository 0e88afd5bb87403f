"""Figures: what the verdicts on many scenes come to, the goals they are held against, and the worst cases by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.goals import goal
from bench.optimization.verdicts import INPUT, SceneVerdicts, Verdict

WORST = 20
"""Worst cases that are listed."""

TIPPED_M = 0.1
"""A tilt by one radian counts as this much displacement among the worst cases [m]."""


def figures(verdicts: Sequence[Verdict]) -> dict[str, float | int]:
    """Figures of one state over scenes. Shares are of the free objects, `fixed_share` of all; lengths [m], times [s].

    nan where nothing is known: a share of nothing, a mean over nothing, and for scans what only a drawn room tells.
    """
    free = sum(len(v.free) for v in verdicts)
    objects = sum(v.objects for v in verdicts)
    moved = np.array([far for v in verdicts for _, far in v.displaced])
    depths = [depth for v in verdicts for _, _, depth in v.deep]
    seconds = np.array([v.seconds for v in verdicts])
    reported, silent = sum(len(v.lost_reported) for v in verdicts), sum(len(v.lost_silently) for v in verdicts)
    return {
        "objects": objects,
        "free_objects": free,
        "fixed_share": _share(objects - free, objects),
        "unplaced": sum(len(v.unplaced) for v in verdicts),
        "fixed_wrongly": _count([v.fixed_wrongly for v in verdicts]),
        "deep_pairs": len(depths),
        "scenes_with_deep_pairs": sum(bool(v.deep) for v in verdicts),
        "deepest_m": max(depths, default=0.0),
        "allowed_pairs": sum(len(v.allowed) for v in verdicts),
        "stable_1cm": _share(free - sum(len(v.unstable_1cm) for v in verdicts), free),
        "stable_5cm": _share(free - sum(len(v.unstable_5cm) for v in verdicts), free),
        "stable_nudged": _share(free - sum(len(v.unstable_nudged) for v in verdicts), free),
        "laid_down": sum(len(v.laid_down) for v in verdicts),
        "fallen": sum(len(v.fallen) for v in verdicts),
        "displacement_mean_m": float(moved.mean()) if len(moved) else math.nan,
        "displacement_p95_m": float(np.quantile(moved, 0.95)) if len(moved) else math.nan,
        "floating": sum(len(v.floating) for v in verdicts),
        "outside": sum(len(v.outside) for v in verdicts),
        "outside_silently": sum(len(v.outside_silently) for v in verdicts),
        "supports_kept": sum(v.carried for v in verdicts) - reported - silent,
        "supports_lost_reported": reported,
        "supports_lost_silently": silent,
        "supports_misjudged": _count([v.misjudged for v in verdicts]),
        "rows_disagreeing": sum(len(v.disagreeing) for v in verdicts),
        "depths_checked": sum(v.depths_checked for v in verdicts),
        "seconds_mean": float(seconds.mean()) if len(seconds) else math.nan,
        "seconds_max": float(seconds.max()) if len(seconds) else math.nan,
    }


def by_state(results: Sequence[SceneVerdicts]) -> dict[str, dict[str, float | int]]:
    """Figures of every state, in the order of the states."""
    states = dict.fromkeys(v.state for result in results for v in result.verdicts)
    return {state: figures([v for result in results for v in result.verdicts if v.state == state]) for state in states}


def by_scene(results: Sequence[SceneVerdicts]) -> list[dict[str, Any]]:
    """Figures of every scene and state."""
    return [{"scene_id": r.scene_id, "piece_seconds": r.piece_seconds, "states": by_state([r])} for r in results]


def goals(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What is asked of the default method and of its speed, what a report has, and whether it is met.

    met is None where the report has nothing of the kind, as a share of no objects: that meets no goal and misses none. A
    number that was measured and is none, as the difference of losses of unequal traces, misses.
    """
    rows: list[tuple[str, float | None, str, float]] = []
    states, moves = report.get("states", {}), report["moves"]
    if "default" in states:
        own = states["default"]
        objects, free = own["objects"] > 0, own["free_objects"] > 0
        carried = own["supports_kept"] + own["supports_lost_reported"] + own["supports_lost_silently"] > 0
        rows += [
            ("pairs deeper than 2 mm", own["deep_pairs"] if objects else None, "<=", 0),
            ("share of free objects stable at 5 cm, 5 degrees", own["stable_5cm"] if free else None, ">=", 0.99),
            ("share of free objects stable at 1 cm, 5 degrees", own["stable_1cm"] if free else None, ">=", 0.97),
            ("the same after nudges of 0.05 m/s", own["stable_nudged"] if free else None, ">=", 0.97),
            ("floating objects", own["floating"] if free else None, "<=", 0),
            ("supports lost and not reported", own["supports_lost_silently"] if carried else None, "<=", 0),
            ("objects out of the room and not reported", own["outside_silently"] if free else None, "<=", 0),
            ("objects fixed wrongly", _known(own["fixed_wrongly"]) if objects else None, "<=", 0),
            ("depths that the rows have otherwise", own["rows_disagreeing"] if objects else None, "<=", 0),
        ]
        if "released" in states:
            farther = own["displacement_mean_m"] - states["released"]["displacement_mean_m"]
            rows.append(("mean displacement above the method `released` [m]", farther if objects else None, "<=", 0.01))
    if "default" in report.get("scene", {}):
        rows.append((f"seconds of a scene of {report['scene']['count']} objects, warm", report["scene"]["default"], "<=", 2.0))
    if "chains" in report:
        rows.append(("rows that are the same for chains on 1 and 2 processes (1: they are)", float(report["chains"]["is_same"]), ">=", 1))
    difference = moves["largest_difference_m3"] if moves["is_same"] else math.nan
    rows.append(("greatest difference of losses over the same moves [m3]", difference, "<=", 1e-9))
    rows.append(("times faster per move than plain Python", moves["speedup"], ">=", 1000.0))
    (few, at_few), *_, (many, at_many) = sorted((int(count), seconds) for count, seconds in moves["seconds_per_move"].items())
    rows.append((f"times as long per move at {many} objects as at {few}", at_many / at_few, "<", many / few))
    return [goal(name, value, sign, limit) for name, value, sign, limit in rows]


def worst_cases(results: Sequence[SceneVerdicts], state: str, most: int = WORST) -> list[dict[str, Any]]:
    """The worst of what is wrong with a state, worst first: scene, instances, categories, what, and how much.

    Depths, gaps and displacements [m] are compared as they are; a support lost silently comes before all.
    """
    cases: list[tuple[float, dict[str, Any]]] = []
    for result in results:
        for v in result.verdicts:
            if v.state == state:
                cases += [(rank, {"scene_id": result.scene_id, **case}) for rank, case in _cases(v, result.categories)]
    cases.sort(key=lambda case: (-case[0], case[1]["scene_id"], case[1]["instances"]))
    return [case for _, case in cases[:most]]


def _cases(v: Verdict, categories: Any) -> list[tuple[float, dict[str, Any]]]:
    """Everything that is wrong with one state of one scene, with its rank."""
    cases: list[tuple[float, tuple[str, ...], str, float]] = []
    cases += [(depth, (a, b), "penetrate [m]", depth) for a, b, depth in v.deep]
    cases += [(min(far, 10.0) + TIPPED_M * tilt, (name,), "unstable, moved by [m]", far) for name, far, tilt in v.unstable_1cm]
    cases += [(min(far, 10.0) + TIPPED_M * tilt, (name,), "moved by a nudge [m]", far) for name, far, tilt in v.unstable_nudged]
    cases += [(gap, (name,), "floats above anything by [m]", gap) for name, gap in v.floating]
    cases += [(reach, (name,), "reaches out of the room by [m]", reach) for name, reach in v.outside]
    cases += [(100.0, (name,), "lost what carried it, not reported", 0.0) for name in v.lost_silently] if v.state != INPUT else []
    return [
        (rank, {"instances": list(names), "categories": [categories.get(name, name) for name in names], "what": what, "amount": amount})
        for rank, names, what, amount in cases
    ]  # fmt: skip


def _share(part: int, whole: int) -> float:
    return part / whole if whole else math.nan


def _count(values: Sequence[Sequence[Any] | None]) -> float | int:
    """How many are in all of the lists that are known; nan when none is."""
    known = [value for value in values if value is not None]
    return sum(map(len, known)) if known else math.nan


def _known(value: float | int) -> float | int | None:
    return None if math.isnan(value) else value
