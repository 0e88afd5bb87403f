"""Figures: what the verdicts on many scenes come to, the goals they are held against, and the worst cases by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flows.bench.verdicts import INPUT, Results, Verdict

WORST = 20
"""Worst cases that are listed."""

TIPPED_M = 0.1
"""A tilt by one radian counts as this much displacement among the worst cases [m]."""


def figures(verdicts: Sequence[Verdict]) -> dict[str, float | int]:
    """Figures of one state over scenes. Shares are of the free things; lengths [m], times [s]; 0 where there is nothing."""
    free = sum(len(v.free) for v in verdicts)
    things = sum(v.things for v in verdicts)
    moved = np.array([far for v in verdicts for _, far in v.displaced])
    depths = [depth for v in verdicts for _, _, depth in v.deep]
    seconds = np.array([v.seconds for v in verdicts])
    reported, silent = sum(len(v.lost_reported) for v in verdicts), sum(len(v.lost_silently) for v in verdicts)
    return {
        "things": things,
        "free_things": free,
        "fixed_share": _share(things - free, things),
        "fixed_wrongly": sum(len(v.fixed_wrongly) for v in verdicts),
        "deep_pairs": len(depths),
        "scenes_with_deep_pairs": sum(bool(v.deep) for v in verdicts),
        "deepest_m": max(depths, default=0.0),
        "allowed_pairs": sum(len(v.allowed) for v in verdicts),
        "stable_1cm": _share(free - sum(len(v.unstable_1cm) for v in verdicts), free),
        "stable_5cm": _share(free - sum(len(v.unstable_5cm) for v in verdicts), free),
        "displacement_mean_m": float(moved.mean()) if len(moved) else 0.0,
        "displacement_p95_m": float(np.quantile(moved, 0.95)) if len(moved) else 0.0,
        "floating": sum(len(v.floating) for v in verdicts),
        "outside": sum(len(v.outside) for v in verdicts),
        "supports_kept": sum(v.carried for v in verdicts) - reported - silent,
        "supports_lost_reported": reported,
        "supports_lost_silently": silent,
        "supports_misjudged": sum(len(v.misjudged) for v in verdicts),
        "rows_disagreeing": sum(len(v.disagreeing) for v in verdicts),
        "seconds_mean": float(seconds.mean()) if len(seconds) else 0.0,
        "seconds_max": float(seconds.max()) if len(seconds) else 0.0,
    }


def by_state(results: Sequence[Results]) -> dict[str, dict[str, float | int]]:
    """Figures of every state, in the order of the states."""
    states = dict.fromkeys(v.state for result in results for v in result.verdicts)
    return {state: figures([v for result in results for v in result.verdicts if v.state == state]) for state in states}


def by_scene(results: Sequence[Results]) -> list[dict[str, Any]]:
    """Figures of every scene and state."""
    return [{"scene_id": r.scene_id, "piece_seconds": r.piece_seconds, "states": by_state([r])} for r in results]


def goals(states: dict[str, dict[str, float | int]], of_39: float | None, speedup: float | None) -> list[dict[str, Any]]:
    """What is asked of the default method, what was found, and whether it is met.

    of_39: seconds of a scene of 39 things. speedup: of the compiled loop over the plain one at 39 things.
    """
    found: list[tuple[str, float, str, float]] = []
    if "default" in states:
        own = states["default"]
        found += [
            ("pairs deeper than 2 mm", own["deep_pairs"], "<=", 0),
            ("share of free things stable at 5 cm, 5 degrees", own["stable_5cm"], ">=", 0.99),
            ("share of free things stable at 1 cm", own["stable_1cm"], ">=", 0.97),
            ("floating things", own["floating"], "<=", 0),
            ("supports lost and not reported", own["supports_lost_silently"], "<=", 0),
        ]
        if "paper" in states:
            farther = own["displacement_mean_m"] - states["paper"]["displacement_mean_m"]
            found.append(("mean displacement above the paper's method [m]", farther, "<=", 0.01))
    if of_39 is not None:
        found.append(("seconds of a scene of 39 things", of_39, "<=", 2.0))
    if speedup is not None:
        found.append(("times faster per move than plain Python", speedup, ">=", 1000.0))
    return [
        {"goal": name, "found": value, "wanted": f"{sign} {limit:g}", "met": bool(value <= limit if sign == "<=" else value >= limit)}
        for name, value, sign, limit in found
    ]


def worst_cases(results: Sequence[Results], state: str, most: int = WORST) -> list[dict[str, Any]]:
    """The worst of what is wrong with a state, worst first: scene, instances, categories, what, and how much.

    Depths, gaps and displacements [m] are compared as they are; a support lost silently comes before all.
    """
    found: list[tuple[float, dict[str, Any]]] = []
    for result in results:
        for v in result.verdicts:
            if v.state == state:
                found += [(rank, {"scene_id": result.scene_id, **case}) for rank, case in _cases(v, result.categories)]
    found.sort(key=lambda case: (-case[0], case[1]["scene_id"], case[1]["instances"]))
    return [case for _, case in found[:most]]


def _cases(v: Verdict, categories: Any) -> list[tuple[float, dict[str, Any]]]:
    """Everything that is wrong with one state of one scene, with its rank."""
    cases: list[tuple[float, tuple[str, ...], str, float]] = []
    cases += [(depth, (a, b), "penetrate [m]", depth) for a, b, depth in v.deep]
    cases += [(min(far, 10.0) + TIPPED_M * tilt, (name,), "unstable, moved by [m]", far) for name, far, tilt in v.unstable_1cm]
    cases += [(gap, (name,), "floats above anything by [m]", gap) for name, gap in v.floating]
    cases += [(reach, (name,), "reaches out of the room by [m]", reach) for name, reach in v.outside]
    cases += [(100.0, (name,), "lost what carried it, not reported", 0.0) for name in v.lost_silently] if v.state != INPUT else []
    return [
        (rank, {"instances": list(names), "categories": [categories.get(name, name) for name in names], "what": what, "amount": amount})
        for rank, names, what, amount in cases
    ]  # fmt: skip


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 1.0
