"""An audit of a lake by its files alone: Delta logs replayed by hand, Parquet read as it lies, blobs hashed.

Nothing here asks the warehouse, so that what it believes of itself is held against something else.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from schemas.tables import TABLES

_LOG = re.compile(r"([0-9]{20})\.json")
_CHECKPOINT = re.compile(r"([0-9]{20})\.checkpoint\.parquet")
_FIXED = ("lake.json", "backup.json", "backup.parquet")
_HISTORY = ("snapshots", "releases", "stage_runs")
"""Tables whose rows tell of when and how often: two lakes with one result differ in them."""


@dataclasses.dataclass(frozen=True)
class Account:
    """A lake as its files tell it. rows: of the last snapshot, by table. named: blobs that rows of any snapshot name.

    expected: every file that has a reason to be there, relative to the lake, blobs apart.
    """

    rows: Mapping[str, list[dict[str, Any]]]
    named: frozenset[str]
    expected: frozenset[str]
    snapshots: int

    @classmethod
    def of(cls, folder: Path) -> Account:
        """Read a local lake; nothing where there is none."""
        listed = _rows(folder, "snapshots", _files(folder, "snapshots", None))
        expected = {name for name in _FIXED if (folder / name).is_file()}
        expected |= {path for table in _tables(folder) for path in _logs(folder, table)}
        expected |= set(_files(folder, "snapshots", None))
        named: set[str] = set()
        rows: dict[str, list[dict[str, Any]]] = {}
        last = max((row["snapshot_id"] for row in listed), default=0)
        read: dict[tuple[str, ...], list[dict[str, Any]]] = {}
        for row in listed:
            for entry in row["tables"]:
                table, version = entry.split("=")
                files = _files(folder, table, int(version))
                expected.update(files)
                key = (table, *files)
                if key not in read:
                    read[key] = _rows(folder, table, files)
                named |= _blobs(table, read[key])
                if row["snapshot_id"] == last:
                    rows[table] = read[key]
        return cls(rows, frozenset(named), frozenset(expected | _released(folder)), len(listed))


def faults_of(folder: Path, twin: Path, *, swept: bool = True) -> list[str]:
    """What is wrong with a lake, held against one that nobody disturbed; a line each. With `swept`, nothing may lie about any more."""
    account, wanted = Account.of(folder), Account.of(twin)
    faults = [*_row_faults(account, wanted), *_run_faults(account, wanted), *_blob_faults(folder, account, swept)]
    if swept:
        there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
        faults += [f"leftover: {path}" for path in sorted(there - account.expected) if not path.startswith("blobs/")]
        faults += [f"missing file: {path}" for path in sorted(account.expected - there)]
    return [*faults, *_release_faults(folder, twin)]


def _row_faults(account: Account, wanted: Account) -> Iterable[str]:
    """Rows lost, rows that should not be there, keys that stand twice."""
    for name in sorted({*account.rows, *wanted.rows} & TABLES.keys()):
        rows = account.rows.get(name, [])
        keys = Counter(tuple(str(row.get(column)) for column in TABLES[name].key) for row in rows)
        doubled = sum(count - 1 for count in keys.values())
        if doubled:
            yield f"{name}: {doubled} rows doubled"
        if name not in _HISTORY:
            lost, added = _difference(_canonical(name, rows), _canonical(name, wanted.rows.get(name, [])))
            if lost or added:
                yield f"{name}: {lost} rows lost, {added} too many or others"


def _run_faults(account: Account, wanted: Account) -> Iterable[str]:
    """Work that was lost, or done twice."""
    counts = [
        Counter((run["scene_id"], run["stage"], run["fingerprint"]) for run in side.rows.get("stage_runs", []) if run["outcome"] == "done")
        for side in (account, wanted)
    ]
    for key in sorted(counts[0].keys() | counts[1].keys()):
        if counts[0][key] != counts[1][key]:
            yield f"stage_runs: {key[0]} {key[1]}: done {counts[0][key]} times instead of {counts[1][key]}"


def _blob_faults(folder: Path, account: Account, swept: bool) -> Iterable[str]:
    """Blobs that rows name and that are not there, blobs that are not what they are called, blobs that nobody names."""
    there = {path.name: path for path in (folder / "blobs").rglob("*") if path.is_file()}
    for name in sorted(account.named - there.keys()):
        yield f"orphan: rows name blob {name}, which is not there"
    for name, path in sorted(there.items()):
        if hashlib.sha256(path.read_bytes()).hexdigest() != name.partition(".")[0]:
            yield f"blob {name}: its content is another"
    if swept:
        yield from (f"orphan: no row names blob {name}" for name in sorted(there.keys() - account.named))


def _release_faults(folder: Path, twin: Path) -> Iterable[str]:
    """Releases that are not those of the twin, or whose files are not what their sums say."""
    names = [{path.parent.name for path in lake.glob("releases/*/release.json")} for lake in (folder, twin)]
    for name in sorted(names[0] ^ names[1]):
        yield f"release {name}: {'too many' if name in names[0] else 'lost'}"
    for name in sorted(names[0] & names[1]):
        place = folder / "releases" / name
        for line in (place / "SHA256SUMS").read_text().splitlines():
            digest, _, file = line.partition("  ")
            if not (place / file).is_file() or hashlib.sha256((place / file).read_bytes()).hexdigest() != digest:
                yield f"release {name}: {file} is not what its sum says"
        for table in sorted(TABLES.keys() - set(_HISTORY)):
            ours, wanted = (_canonical(table, _parquet(lake / "releases" / name / f"{table}.parquet")) for lake in (folder, twin))
            lost, added = _difference(ours, wanted)
            if lost or added:
                yield f"release {name}: {table}: {lost} rows lost, {added} too many or others"


def _canonical(table: str, rows: Iterable[Mapping[str, Any]]) -> Counter[str]:
    """Rows as text, without what may differ from run to run."""
    volatile = set(TABLES[table].volatile_columns)
    return Counter(json.dumps({k: v for k, v in row.items() if k not in volatile}, sort_keys=True, default=str) for row in rows)


def _difference(ours: Counter[str], wanted: Counter[str]) -> tuple[int, int]:
    """How many rows are lost, and how many are too many."""
    return (wanted - ours).total(), (ours - wanted).total()


def _tables(folder: Path) -> list[str]:
    place = folder / "tables"
    return sorted(path.name for path in place.iterdir() if path.is_dir()) if place.is_dir() else []


def _logs(folder: Path, table: str) -> list[str]:
    """Files of a table's log that are what they should be."""
    place = folder / "tables" / table / "_delta_log"
    names = [path.name for path in place.iterdir()] if place.is_dir() else []
    kept = [name for name in names if _LOG.fullmatch(name) or _CHECKPOINT.fullmatch(name) or name == "_last_checkpoint"]
    return [f"tables/{table}/_delta_log/{name}" for name in kept]


def _files(folder: Path, table: str, version: int | None) -> list[str]:
    """Data files of a table at a version, the newest by default, by playing its log."""
    logs = {path.rpartition("/")[2]: folder / path for path in _logs(folder, table)}
    changes = {int(match[1]): logs[name] for name in logs if (match := _LOG.fullmatch(name))}
    checkpoints = {int(match[1]): logs[name] for name in logs if (match := _CHECKPOINT.fullmatch(name))}
    last = max(changes, default=-1) if version is None else version
    start = max((number for number in checkpoints if number <= last), default=-1)
    held: dict[str, None] = {}
    if start >= 0:
        for row in pq.read_table(checkpoints[start], columns=["add"]).to_pylist():
            if row["add"]:
                held[row["add"]["path"]] = None
    for number in range(start + 1, last + 1):
        for line in changes[number].read_text().splitlines():
            action = json.loads(line)
            if "remove" in action:
                held.pop(action["remove"]["path"], None)
            if "add" in action:
                held[action["add"]["path"]] = None
    return sorted(f"tables/{table}/{name}" for name in held)


def _rows(folder: Path, table: str, files: Iterable[str]) -> list[dict[str, Any]]:
    """Rows of a table's data files, with null for columns that a file lacks."""
    read = [pq.ParquetFile(folder / path).read() for path in files]
    if not read:
        return []
    rows: list[dict[str, Any]] = pa.concat_tables(read, promote_options="permissive").to_pylist()
    return rows


def _parquet(path: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.ParquetFile(path).read().to_pylist() if path.is_file() else []
    return rows


def _blobs(table: str, rows: Iterable[Mapping[str, Any]]) -> set[str]:
    columns = TABLES[table].blob_columns if table in TABLES else ()
    return {row[column] for row in rows for column in columns if row.get(column)}


def _released(folder: Path) -> set[str]:
    """Files of the releases: what their sums name, the sums and the record."""
    paths: set[str] = set()
    for sums in folder.glob("releases/*/SHA256SUMS"):
        place = sums.parent.relative_to(folder).as_posix()
        if (sums.parent / "release.json").is_file():
            paths |= {f"{place}/{name}" for name in ("SHA256SUMS", "release.json")}
            paths |= {f"{place}/{line.partition('  ')[2]}" for line in sums.read_text().splitlines()}
    return paths
