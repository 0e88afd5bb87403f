"""One asset for several objects of a category that it fits nearly as well as their own best: the chairs round a table are one model,
however differently their scans came out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

from schemas.selection import Selection


def shared(rankings: Mapping[str, Sequence[Selection]], categories: Mapping[str, str], most_lost: float) -> dict[str, list[Selection]]:
    """Rankings by instance in which an asset that fits several of a category goes first for each of them, and tells so in `look`.

    Of all assets the one that does for the most instances, then the one that fits them best, and so on with the others. It does for an
    instance whose own best score is at most `most_lost` higher.
    """
    scores: dict[str, dict[str, float]] = {
        name: {row.asset_id: row.score for row in reversed(rows)} for name, rows in sorted(rankings.items())
    }
    chosen: dict[str, tuple[str, str]] = {}
    for category in sorted({categories[name] for name in scores} - {""}):
        open_names = [name for name in scores if categories[name] == category and scores[name]]
        while True:
            does_for = _by_asset(open_names, scores, most_lost)
            best = max(
                does_for, key=lambda asset: (len(does_for[asset]), sum(scores[n][asset] for n in does_for[asset]), asset), default=None
            )
            if best is None or len(does_for[best]) < 2:
                break
            for name in does_for[best]:
                chosen[name] = (best, does_for[best][0])
            open_names = [name for name in open_names if name not in chosen]
    return {name: _ranked(rows, *chosen[name]) if name in chosen else list(rows) for name, rows in rankings.items()}


def _by_asset(names: Sequence[str], scores: Mapping[str, Mapping[str, float]], most_lost: float) -> dict[str, list[str]]:
    """The instances that an asset does for, by asset."""
    does_for: dict[str, list[str]] = {}
    for name in names:
        best = max(scores[name].values())
        for asset, score in scores[name].items():
            if round(best - score, 9) <= most_lost:
                does_for.setdefault(asset, []).append(name)
    return does_for


def _ranked(rows: Sequence[Selection], asset: str, look: str) -> list[Selection]:
    """Rows of an instance with those of an asset first."""
    ordered = sorted(rows, key=lambda row: (row.asset_id != asset, row.rank))
    return [dataclasses.replace(row, rank=rank, look=look) for rank, row in enumerate(ordered, start=1)]
