"""What a lake must refuse: bad SQL, writing by SQL, names that are SQL, foreign files. Nothing may change by it.

Every attempt is made on a small lake whose files are hashed before and after. An attempt is refused when it ends in an error
that is one line, or, where there is nothing to say, when the answer is what it was before.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from bench.warehouse.generator import copied_lake
from schemas.capture import Scene
from schemas.errors import LakeError
from schemas.runs import StageRun
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.questions.sql import query
from warehouse.upkeep.inspection.folders import staged_findings
from warehouse.upkeep.inspection.tables import TableChecks

BAD = ("SELEC 1", "SELECT nothing FROM scenes", "SELECT * FROM no_such_table", "SELECT 1 +", "", "SELECT '")
"""SQL that is none, or asks for what is not there."""

WRITING = (
    "DELETE FROM scenes",
    "INSERT INTO scenes SELECT * FROM scenes",
    "UPDATE scenes SET dataset = 'other'",
    "DROP VIEW scenes",
    "CREATE OR REPLACE VIEW scenes AS SELECT 1",
    "CREATE TABLE copied AS FROM scenes",
    "ALTER VIEW scenes RENAME TO other",
    "COPY scenes TO '{file}' (FORMAT parquet)",
    "COPY (SELECT 1) TO '{foreign}'",
    "WITH written AS (COPY (SELECT 1) TO '{file}') SELECT 1",
    "SELECT 1; COPY (SELECT 1) TO '{file}' (FORMAT parquet)",
    "EXPLAIN ANALYZE COPY (SELECT 1) TO '{file}' (FORMAT parquet)",
    "EXPORT DATABASE '{folder}'",
    "ATTACH '{foreign}' AS other",
    "INSTALL httpfs",
    "LOAD httpfs",
    "SET enable_external_access = true",
    "PRAGMA enable_external_access",
    "CALL pragma_version()",
    "SELECT * FROM read_text('/etc/hostname')",
    "SELECT * FROM query('DROP VIEW scenes')",
)
"""SQL that would change something, or reach beyond the lake. {file} is a data file of the lake, {foreign} one beside it."""

NAMES = (
    "x'; DROP VIEW scenes; --",
    "generated/x' OR '1' = '1",
    "generated/../../lake",
    'generated/x"; DELETE FROM scenes; --',
    "generated/x\x00y",
    "generated/x') OR scene_id IN (SELECT scene_id FROM scenes) --",
)
"""Names of scenes that are none."""


@dataclasses.dataclass(frozen=True)
class Trial:
    """What was tried, the message (None: nothing), and whether that is right and left the lake as it was."""

    kind: str
    tried: str
    message: str | None
    refused: bool
    unchanged: bool


def try_everything(lake: Lake) -> list[Trial]:
    """All attempts on a local lake that has scenes. It is as before when all went well."""
    folder = Path(lake.address)
    files = {
        "file": str(folder / lake.snapshot().files("scenes")[0]),
        "foreign": str(folder.parent / "foreign.parquet"),
        "folder": str(folder / "exported"),
    }
    scenes = lake.snapshot().arrow("scenes")["scene_id"].to_pylist()
    made = [_refused(lake, "bad SQL", sql, partial(_ask, lake, sql)) for sql in BAD]
    for text in WRITING:
        sql = text.format(**{name: path.replace("'", "''") for name, path in files.items()})
        made.append(_refused(lake, "writing by SQL", text, partial(_ask, lake, sql)))
    for name in NAMES:
        made.append(_refused(lake, "a scene's name", f"stage {name!r}", partial(_stage, lake, name)))
        made.append(_empty(lake, f"read {name!r}", partial(_read, lake, name)))
        made.append(_empty(lake, f"remove {name!r}", partial(_remove, lake, name)))
    for table in ("instances", "scenes", "stage_runs"):
        made.append(_foreign_data(lake, table, len(scenes)))
    (folder / "staged").mkdir(exist_ok=True)
    for what, data in (("another schema", _foreign()), ("no Parquet", b"this is no Parquet file")):
        made.append(_foreign_staged(lake, data, what))
        with tempfile.TemporaryDirectory(prefix="bench-", dir=folder.parent) as place:
            made.append(_foreign_rows(copied_lake(lake, Path(place) / "lake"), data, what))
    return made


def digest_of(folder: Path) -> str:
    """Hash of the paths and contents of all files below a folder."""
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(f"{path.relative_to(folder)}|".encode())
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()


def _attempt(lake: Lake, kind: str, tried: str, act: Callable[[], tuple[str | None, bool]]) -> Trial:
    """`act` gives what was said, and whether that is right."""
    folder = Path(lake.address)
    before = digest_of(folder)
    answer, refused = act()
    return Trial(kind, tried, answer, refused, digest_of(folder) == before)


def _refused(lake: Lake, kind: str, tried: str, do: Callable[[], Any]) -> Trial:
    """An attempt that must end in an error of one line."""

    def act() -> tuple[str | None, bool]:
        try:
            do()
        except LakeError as error:
            return str(error), len(str(error)) > 0 and "\n" not in str(error)
        except Exception as error:  # a crash is no refusal: told as it is
            return f"{type(error).__name__}: {error}", False
        return None, False

    return _attempt(lake, kind, tried, act)


def _empty(lake: Lake, tried: str, count: Callable[[], int]) -> Trial:
    """An attempt whose answer must be that there is nothing."""

    def act() -> tuple[str | None, bool]:
        try:
            return None, count() == 0
        except LakeError as error:
            return str(error), True

    return _attempt(lake, "a scene's name", tried, act)


def _ask(lake: Lake, sql: str) -> None:
    query(lake.snapshot(), sql)


def _stage(lake: Lake, name: str) -> None:
    """Stage a scene of that name; past the check of its blobs, which generated lakes do not have."""
    scene = lake.snapshot().rows(Scene)[0]
    lake.staging.stage(_run(name), {"scenes": [dataclasses.replace(scene, scene_id=name)]})


def _read(lake: Lake, name: str) -> int:
    """Rows that a scene of that name has."""
    return int(lake.snapshot().arrow("instances", name).num_rows)


def _remove(lake: Lake, name: str) -> int:
    """Snapshots that removing a scene of that name makes."""
    return int(lake.remove_scene(name) is not None)


def _foreign_data(lake: Lake, table: str, scenes: int) -> Trial:
    """A Parquet file of another schema among the data files of a table: nobody reads it, and an inspection names it."""
    path = Path(lake.address) / "tables" / table / "part-00000-foreign.parquet"

    def act() -> tuple[str | None, bool]:
        before = lake.snapshot().arrow(table).num_rows
        path.write_bytes(_foreign())
        try:
            reader = lake.snapshot()
            asked = query(reader, f"SELECT count(*) AS found FROM {table}")["found"][0].as_py()
            named = _named_by_inspection(lake, path.name)
            return named, bool(named) and asked == before == reader.arrow(table).num_rows and reader.arrow("scenes").num_rows == scenes
        finally:
            path.unlink()

    return _attempt(lake, "a foreign file", f"in tables/{table}/", act)


def _foreign_staged(lake: Lake, data: bytes, what: str) -> Trial:
    """A file that no worker left among the staged ones: no commit takes it in, and an inspection names it."""
    path = Path(lake.address) / "staged" / "foreign.parquet"

    def act() -> tuple[str | None, bool]:
        path.write_bytes(data)
        try:
            committed = lake.commit("foreign")
            named = _named_by_inspection(lake, path.name)
            return named, bool(named) and committed is None
        finally:
            path.unlink()

    return _attempt(lake, "a foreign file", f"in staged/: {what}", act)


def _foreign_rows(lake: Lake, data: bytes, what: str) -> Trial:
    """A file in the place of a staged run's rows: the commit says that the run is lost, and takes no row of it."""
    scene = lake.snapshot().rows(Scene)[0]
    before = {table.name: lake.snapshot().arrow(table.name) for table in TABLES.values() if table.stage}
    lake.staging.stage(_run(scene.scene_id), {"scenes": [dataclasses.replace(scene, dataset="other")]})
    for staged in lake.staging.runs():
        (Path(lake.address) / staged.files["scenes"]).write_bytes(data)
    lake.commit("foreign")
    lost = [run for run in lake.snapshot().rows(StageRun, scene.scene_id) if run.outcome == "lost"]
    error = lost[0].error if lost else None
    unchanged = all(lake.snapshot().arrow(name).equals(rows) for name, rows in before.items())
    return Trial("a foreign file", f"as rows of a staged run: {what}", error, error is not None and "\n" not in error, unchanged)


def _named_by_inspection(lake: Lake, name: str) -> str | None:
    """What an inspection says of a file; None when nothing."""
    checks = TableChecks(lake, lake.snapshot().snapshots)
    list(checks.versions())
    return next((str(finding) for finding in [*checks.strangers(), *staged_findings(lake)] if finding.file.endswith(name)), None)


def _foreign() -> bytes:
    """A Parquet file with a row that no table has."""
    import pyarrow.parquet as pq

    sink = io.BytesIO()
    pq.write_table(pa.table({"scene_id": [1], "payload": ["a"]}), sink)
    return sink.getvalue()


def _run(scene_id: str) -> StageRun:
    return StageRun(
        scene_id=scene_id, stage="capture", fingerprint="0" * 64, attempt=1, outcome="done", upstream=(), reasons=(), config="{}",
        row_counts=(), degradations=(), error=None, error_kind=None, started_at=datetime(2026, 1, 1, tzinfo=UTC), seconds=1.0,
        host="here:1", peak_memory_mb=1.0, snapshot_id=0,
    )  # fmt: skip
