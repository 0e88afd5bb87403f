"""Whether every version of every table is there: Delta logs, data files, and what lies beside them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Sequence

import pyarrow as pa

from schemas.parsing import json_value
from schemas.runs import Snapshot
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.tables.commit import versions_of
from warehouse.tables.datafiles import DATA_FILE, log_version
from warehouse.tables.delta import FOLDER
from warehouse.upkeep.inspection.finding import Fault, in_short
from warehouse.upkeep.inspection.rows import type_findings

_RESTORE = "restore the file from a backup"


@dataclasses.dataclass
class TableFiles:
    """Data files of the snapshots, by snapshot and table: those that are there and can be read."""

    at: dict[int, dict[str, list[str]]] = dataclasses.field(default_factory=dict)
    named: set[str] = dataclasses.field(default_factory=set)
    size: int = 0
    reclaimable: int = 0


class TableChecks:
    """Checks of the tables' folders for some snapshots."""

    def __init__(self, lake: Lake, snapshots: Sequence[Snapshot]) -> None:
        self._lake, self._snapshots = lake, snapshots
        self._sound: dict[str, bool] = {}
        self.files = TableFiles()

    def versions(self) -> Iterator[Fault]:
        """Versions that snapshots name and cannot be opened, and data files that are missing or not what the log says."""
        seen: dict[tuple[str, int], list[str]] = {}
        for snapshot in self._snapshots:
            at = self.files.at.setdefault(snapshot.snapshot_id, {})
            for table, version in versions_of(snapshot).items():
                if (table, version) not in seen:
                    seen[(table, version)] = []
                    yield from self._version(table, version, seen[(table, version)])
                at[table] = seen[(table, version)]
        head = self._lake.tables.open("snapshots")
        if head is not None:
            yield from self._version("snapshots", int(head.version()), [])

    def _version(self, table: str, version: int, sound: list[str]) -> Iterator[Fault]:
        """Check one version; the paths of its readable files go into `sound`."""
        folder = f"{FOLDER}/{table}"
        try:
            opened = self._lake.tables.open(table, version)
        except Exception as error:  # delta-rs has many, and a log can be broken in all ways
            yield Fault("log", f"{folder}/_delta_log", f"version {version}", f"cannot be opened ({in_short(error)})", "restore the folder")
            return
        if opened is None:
            yield Fault("version", folder, f"version {version}", "is missing, which a snapshot names", "restore the folder")
            return
        actions = pa.table(opened.get_add_actions())
        rows = actions.column("num_records").to_pylist() if "num_records" in actions.column_names else [None] * actions.num_rows
        for name, size, count in zip(actions.column("path").to_pylist(), actions.column("size_bytes").to_pylist(), rows, strict=True):
            path = f"{folder}/{name.rpartition('/')[2]}"
            self.files.named.add(path)
            if path not in self._sound:
                findings = list(self._data_file(table, path, size, count))
                self._sound[path] = not any(finding.kind != "type" for finding in findings)
                yield from findings
            if self._sound[path]:
                sound.append(path)

    def _data_file(self, table: str, path: str, size: int, rows: int | None) -> Iterator[Fault]:
        import pyarrow.parquet as pq

        storage = self._lake.storage
        filesystem, place = storage.arrow_filesystem(), storage.arrow_path(path)
        info = filesystem.get_file_info(place)
        if not info.is_file:
            yield Fault("data file", path, "", "is missing, which a snapshot names", _RESTORE)
            return
        self.files.size += info.size
        if info.size != size:
            yield Fault("size", path, "size", f"is {info.size} B where the log says {size} B", _RESTORE)
            return
        try:
            footer = pq.read_metadata(place, filesystem=filesystem)
            schema = footer.schema.to_arrow_schema()
        except (pa.ArrowException, OSError) as error:
            yield Fault("footer", path, "", f"cannot be read ({in_short(error)})", _RESTORE)
            return
        if rows is not None and footer.num_rows != rows:
            yield Fault("rows", path, "rows", f"has {footer.num_rows} where the log says {rows}", _RESTORE)
            return
        if table in TABLES:
            yield from type_findings(table, path, schema)

    def strangers(self) -> Iterator[Fault]:
        """Files in the tables' folders that nobody needs, and folders that are no tables."""
        named = {table for snapshot in self._snapshots for table in versions_of(snapshot)} | {"snapshots"}
        for table in self._lake.storage.folders(FOLDER):
            folder = f"{FOLDER}/{table}"
            if table not in TABLES and table not in named:
                yield Fault("table", folder, "", "is no table of the lake", "remove the folder", False)
                continue
            logged: set[str] | None = None
            for entry in self._lake.storage.walk(folder):
                inner = entry.path.removeprefix(f"{folder}/")
                name = inner.rpartition("/")[2]
                if inner == f"_delta_log/{name}" and (log_version(name) is not None or name == "_last_checkpoint"):
                    continue
                if re.search(r"#[0-9]+$|^_commit_.*\.json\.tmp$", name):
                    yield Fault("unfinished file", entry.path, "", "was left by a write that was killed", "the next run removes it", False)
                elif inner != name or not DATA_FILE.fullmatch(name):
                    yield Fault("foreign file", entry.path, "", "is none of the lake's", "move it away", False)
                elif entry.path not in self.files.named:
                    logged = self._logged(folder) if logged is None else logged
                    if name in logged:  # an older version's, between two snapshots
                        self.files.reclaimable += entry.size
                    else:
                        problem = "is named by no version of the table"
                        yield Fault("unnamed file", entry.path, "", problem, "`metascenes lake vacuum` removes it", False)

    def _logged(self, folder: str) -> set[str]:
        """Names of all data files that a table's log speaks of."""
        import io

        import pyarrow.parquet as pq

        logged: set[str] = set()
        for entry in self._lake.storage.entries(f"{folder}/_delta_log"):
            data = self._lake.storage.read(entry.path)
            if entry.path.endswith(".json"):
                for line in data.decode(errors="replace").splitlines():
                    try:
                        action = json_value(line)
                    except ValueError:
                        continue
                    logged.update(str(action[kind]["path"]) for kind in ("add", "remove") if kind in action)
            elif entry.path.endswith(".parquet"):
                for row in pq.read_table(io.BytesIO(data), columns=["add", "remove"]).to_pylist():
                    logged.update(row[kind]["path"] for kind in ("add", "remove") if row[kind])
        return logged
