"""`metascenes scenes`: the scenes of a lake, a line each."""

from __future__ import annotations

import fnmatch
import json
from collections.abc import Sequence
from typing import Any

import click

from flows.commands.options import chosen_snapshot, existing_lake, json_option, lake_option, snapshot_options


@click.command("scenes", short_help="List the scenes of a lake: what each is, how far it has come, how much of it stands.")
@click.argument("patterns", nargs=-1, metavar="[PATTERN]...")
@click.option("--failed", is_flag=True, help="Only scenes of which a stage failed at its last attempt.")
@click.option("--room-type", "room_types", multiple=True, metavar="TYPE", help="Only rooms of this type, as in bedroom; may be repeated.")
@click.option("--dataset", "datasets", multiple=True, metavar="NAME", help="Only scenes of this dataset; may be repeated.")
@snapshot_options
@lake_option
@json_option
def command(
    patterns: tuple[str, ...], failed: bool, room_types: tuple[str, ...], datasets: tuple[str, ...], snapshot_id: int | None,
    release: str | None, address: str, as_json: bool,
) -> None:  # fmt: skip
    """List the scenes of a lake: kind of room, dataset, scan format, objects, stages done and failed, seconds, share that is stable.

    A PATTERN is a scene's id, or one of shell patterns; without a slash it speaks of the scan's name. The list is the view
    `scene_overview`, to which `metascenes sql` can put other questions. Stable are objects that stay within 5 cm, of those
    that are free to move. Errors of stages are in `metascenes status`, and with --json.

    Example: metascenes scenes "scene00*" --room-type bedroom --failed --lake ./lake
    """
    from schemas.errors import InputError
    from schemas.wording import counted, meant
    from warehouse.questions.sql import query

    lake = existing_lake(address)
    reader = lake.snapshot(chosen_snapshot(lake, snapshot_id, release))
    every = query(reader, "FROM scene_overview").to_pylist()
    for option, column, wanted in (("--room-type", "room_type", room_types), ("--dataset", "dataset", datasets)):
        known = sorted({row[column] for row in every if row[column] is not None})
        for word in wanted:
            if word not in known:
                remedy = f"{meant(word, known)}it has {', '.join(known)}" if known else "see `metascenes status`"
                raise InputError(lake.address, option, f"has no scene of {word}", remedy)
    for pattern in patterns:
        if not any(_matches(row["scene_id"], pattern) for row in every):
            names = [_as_in(row["scene_id"], pattern) for row in every]
            raise InputError(lake.address, pattern, "matches no scene", f"{meant(pattern, names)}`metascenes scenes` lists all")
    rows = [
        row
        for row in every
        if (not patterns or any(_matches(row["scene_id"], pattern) for pattern in patterns))
        and (not room_types or row["room_type"] in room_types)
        and (not datasets or row["dataset"] in datasets)
        and (row["stages_failed"] or not failed)
    ]
    if as_json:
        print(json.dumps({"snapshot_id": reader.snapshot_id, "scenes": rows}, ensure_ascii=False))
        return
    for line in _table(rows):
        print(line)
    wrong = sum(row["stages_failed"] > 0 for row in rows)
    print(f"{counted(len(rows), 'scene')}{f' of {len(every)}' if len(rows) < len(every) else ''}, {wrong} failed")


def _matches(scene_id: str, pattern: str) -> bool:
    return fnmatch.fnmatchcase(_as_in(scene_id, pattern), pattern)


def _as_in(scene_id: str, pattern: str) -> str:
    """The scene's id, or the scan's part of it where a pattern has no slash."""
    return scene_id if "/" in pattern else scene_id.rpartition("/")[2]


_HEAD = ("scene", "room type", "dataset", "format", "objects", "done", "failed", "seconds", "stable")
_NUMBERS = 4
"""Columns before those with numbers, which stand to the right."""


def _table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A head and a line per scene, in columns; no lines for no scenes."""
    if not rows:
        return []
    cells = [_HEAD, *(_cells(row) for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(_HEAD))]
    lines = []
    for line, row in zip(cells, [None, *rows], strict=True):
        words = [word.ljust(width) for word, width in zip(line[:_NUMBERS], widths, strict=False)]
        words += [word.rjust(width) for word, width in zip(line[_NUMBERS:], widths[_NUMBERS:], strict=True)]
        lines.append("  ".join([*words, *(row["failed_stages"] if row else ())]).rstrip())
    return lines


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    share = row["stable_5cm_share"]
    return (
        row["scene_id"], row["room_type"] or "-", row["dataset"], row["scan_format"] or "-",
        "-" if row["objects"] is None else str(row["objects"]), str(row["stages_done"]), str(row["stages_failed"]),
        f"{row['seconds']:.1f}", "-" if share is None else f"{share:.0%}",
    )  # fmt: skip
