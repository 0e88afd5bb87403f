"""Reports: what the optimization itself says went wrong with which object, read from its rows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from bench.optimization.measures import FLOOR
from bench.rooms import Carried
from tasks.stage import Outcome

STANDS_BESIDE = re.compile(r"\bit stands beside (?P<lost>\d{4,}), on ")
"""It was taken to be carried by the one and is carried by another."""

SET_DOWN = re.compile(r"\bnothing carried it; it was set down [\d.]+ m onto (?P<now>\d{4,}|the floor)")
"""It was taken to be carried by nothing and is carried by another now."""

CARRIED_BY_NOTHING = re.compile(r"\bnothing carries it\b")

OUTSIDE = re.compile(r"\blies outside of the room\b")


def reported_losses(outcome: Outcome, was_carried: Mapping[str, Carried]) -> set[str]:
    """Objects of which the rows say that what carried them, `was_carried`, carries them no more.

    Either `supports.is_kept` is false, or a line says that nothing carries the object, that it stands beside that very
    carrier, or that it was set down onto something else. No other complaint about an object counts.
    """
    lost = {row.instance_id for row in outcome.rows["supports"] if not row.is_kept}
    for name, text in _lines(outcome):
        was = was_carried.get(name)
        if was is None:
            continue
        carrier = was.parent_id or (FLOOR if was.relation == "floor" else None)
        beside, down = STANDS_BESIDE.search(text), SET_DOWN.search(text)
        now = down["now"].removeprefix("the ") if down else None
        if CARRIED_BY_NOTHING.search(text) or (beside and beside["lost"] == carrier) or (down and now != carrier):
            lost.add(name)
    return lost


def reported_outside(outcome: Outcome) -> set[str]:
    """Objects of which the rows say that they lie outside of the room."""
    return {name for name, text in _lines(outcome) if OUTSIDE.search(text)}


def _lines(outcome: Outcome) -> Iterator[tuple[str, str]]:
    """What is said of each object: its instance id and the text."""
    for row in outcome.rows["placements"]:
        if row.remains:
            yield row.instance_id, row.remains
    for line in outcome.degradations:
        name, colon, text = line.partition(": ")
        if colon:
            yield name, text
