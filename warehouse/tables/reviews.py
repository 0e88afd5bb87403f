"""Answers that stand: those that were handed in and accepted (`warehouse.tables.gate`). All that reads answers for a layout reads them
here."""

from __future__ import annotations

import pyarrow as pa

from warehouse.tables.gate import BatchState, batch_states
from warehouse.tables.snapshot import Reader


def standing_answers(reader: Reader, scene_id: str | None = None) -> pa.Table:
    """Rows of `annotations` that count, sorted by key; of one scene when `scene_id` is given."""
    rows = reader.arrow("annotations", scene_id)
    if not rows.num_rows:
        return rows
    states = batch_states(reader, set(rows.column("batch_id").unique().to_pylist()))
    return rows.take(pa.array(_standing(rows, states), pa.int64()))


def _standing(rows: pa.Table, states: dict[str, BatchState]) -> list[int]:
    """Indices of the rows that count: the revisions that were handed in, of what came before there were submissions the last ones; none
    of an answer that was withdrawn in the end."""
    names = ("batch_id", "scene_id", "instance_id", "annotator", "revision", "is_withdrawn")
    kept: dict[tuple[str, ...], int] = {}
    columns = [rows.column(name).to_pylist() for name in names]
    for index, (batch, scene, instance, annotator, revision, is_withdrawn) in enumerate(zip(*columns, strict=True)):
        state = states[batch]
        if not state.counts:
            continue
        key = (scene, instance, annotator)
        if is_withdrawn:  # rows are sorted by key, so that the last revision comes last
            kept.pop((batch, *key), None)
        elif state.batch is None or state.handed_in.get(key) == revision:
            kept[batch, *key] = index
    return sorted(kept.values())
