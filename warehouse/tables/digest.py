"""Whether two lakes hold the same result.

The digest of a table is taken over its rows sorted by key, without the columns that the schema declares volatile.
Of `stage_runs` only the runs whose rows are in the lake count, and the last failure where there are none: how often
something was tried, and what was withdrawn on the way, is no part of the result. Neither are `snapshots`, `releases` and
`refused_scans`.
"""

from __future__ import annotations

import hashlib
import json
from datetime import datetime
from typing import Any

import pyarrow as pa

from schemas.record import Table, rows_to_arrow
from schemas.runs import StageRun
from schemas.tables import TABLES
from warehouse.tables.history import states
from warehouse.tables.snapshot import Reader


def digests(reader: Reader) -> dict[str, str]:
    """SHA-256 of every table's rows, and under `blobs` of the set of blobs that rows name."""
    by_table = {}
    for table in TABLES.values():
        if table.name in ("snapshots", "releases", "refused_scans"):
            continue
        by_table[table.name] = _digest(_result_runs(reader) if table.name == "stage_runs" else reader.arrow(table.name), table)
    by_table["blobs"] = hashlib.sha256("\n".join(sorted(blob_names(reader))).encode()).hexdigest()
    return by_table


def blob_names(reader: Reader) -> frozenset[str]:
    """Names of all blobs that the rows of a snapshot name."""
    names: set[str] = set()
    for table in TABLES.values():
        if table.blob_columns:
            rows = reader.arrow(table.name)
            for column in table.blob_columns:
                names.update(name for name in rows.column(column).unique().to_pylist() if name is not None)
    return frozenset(names)


def _result_runs(reader: Reader) -> pa.Table:
    current = states(reader.arrow("stage_runs")).values()
    return rows_to_arrow([state.done or state.last for state in current if state.done or state.last.outcome == "failed"], StageRun)


def _digest(rows: pa.Table, table: Table) -> str:
    kept = [column.name for column in table.columns if not column.volatile]
    keys = [name for name in table.key if name in kept]
    rows = rows.select(kept).sort_by([(name, "ascending") for name in keys])
    total = hashlib.sha256(json.dumps(kept).encode())
    for batch in rows.to_batches(max_chunksize=4096):
        for row in batch.to_pylist():
            # `repr` of a float is exact, and so is JSON's; -0.0 and 0.0 differ, as their bytes do.
            total.update(json.dumps(list(row.values()), default=_plain, ensure_ascii=True).encode() + b"\n")
    return total.hexdigest()


def _plain(value: Any) -> str:
    if isinstance(value, datetime):
        return value.isoformat()
    raise TypeError(f"no column holds a {type(value).__name__}")
