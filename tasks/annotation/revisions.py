"""Answers that come again: which are known, which correct an earlier one, and which come too late to."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Mapping, Sequence

from schemas.annotation import Annotation
from schemas.errors import InputError

Key = tuple[str, str, str]
"""Scene, instance and annotator."""


def revised(
    present: Sequence[Annotation], given: Sequence[Annotation], places: Mapping[Key, tuple[str, str]], is_dated: bool = True
) -> list[Annotation]:
    """Those of the `given` answers of a batch that are new to it, as the next revision of what is `present`.

    An answer that says what any revision of it says, at the same time, is known; where answers are not dated, one that says what the
    last revision of its tool says. `places`: file and JSON path of every given answer.

    Raises:
        InputError: an answer differs from what is present and was not given later: one cannot tell which of the two holds; or one is
            withdrawn that was never given.
    """
    known: dict[Key, list[Annotation]] = defaultdict(list)
    for row in sorted(present, key=lambda row: row.revision):
        known[key_of(row)].append(row)
    new = []
    for row in given:
        before = known[key_of(row)]
        file, where = places[key_of(row)]
        if any(_content(row) == _content(earlier) for earlier in before):
            continue
        same_tool = [earlier for earlier in before if earlier.tool == row.tool]
        if same_tool and not is_dated:
            last = same_tool[-1]  # what others corrected since stays: the tool has nothing new to say
            if _content(dataclasses.replace(row, answered_at=last.answered_at)) == _content(last):
                continue
        if before and row.answered_at <= before[-1].answered_at:
            problem = f"is not later than that of the answer in the lake ({before[-1].answered_at.isoformat()}), and the two differ"
            raise InputError(file, f"{where}.answered_at", problem, "give the time of the correction")
        if row.is_withdrawn and not before:
            problem = f"{row.annotator} has not answered for {row.scene_id} {row.instance_id} in this batch"
            raise InputError(file, f"{where}.withdrawn", problem, "leave it out")
        new.append(dataclasses.replace(row, revision=len(before) + 1))
    return new


def latest(rows: Sequence[Annotation]) -> dict[Key, Annotation]:
    """The last revision of every answer of one batch; those that were withdrawn are left out."""
    last: dict[Key, Annotation] = {}
    for row in sorted(rows, key=lambda row: row.revision):
        last[key_of(row)] = row
    return {key: last[key] for key in sorted(last) if not last[key].is_withdrawn}


def key_of(row: Annotation) -> Key:
    """What an answer of a batch goes by."""
    return row.scene_id, row.instance_id, row.annotator


def _content(row: Annotation) -> Annotation:
    """What an answer says, wherever it was read from and whatever box its instance has by now."""
    return dataclasses.replace(row, revision=1, source_file="", box_pose=(), box_size=())
