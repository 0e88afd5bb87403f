"""A lake of many scenes made up from a seed: plausible rows in every table, in the proportions of a real lake.

What a row says is SQL, `rows/<table>.sql` over `prelude.sql`, or made up from the schema where a table has no such file; it is
written through the lake's own writer, so that files, versions and snapshots are those that commits leave. Blobs are named but
not there.

Three proportions are not those of a real lake, to keep the full size at 5 GB: a scene has 40 export files (a real one has
about 1,300, most of them hulls for URDF), 10 episodes (about 80) and 100 optimization steps (about 500). The mask of an object
is six runs, and of ten candidates nine come from a library that all scenes share.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from bench.samples import sample
from flows.run.fingerprints import cache_folder
from schemas.errors import InputError
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.families.policies import POLICIES
from schemas.record import Table, rows_to_arrow
from schemas.runs import Release, Snapshot
from schemas.tables import TABLES
from warehouse.lake import FORMAT, MARKER, Lake
from warehouse.questions.documentation import sql_type
from warehouse.questions.quoting import quoted
from warehouse.sharing.writer import new_token
from warehouse.storage.files import storage_at
from warehouse.tables import delta
from warehouse.tables.delta import DeltaTables, nullable
from warehouse.tables.released import RECORD, folder_of, record_fields

SHARES = (0.5, 0.8, 1.0)
"""A lake is made in three snapshots, after these shares of its scenes."""

_HERE = Path(__file__).parent
_PICKS = 2**16

# Measured at 100,000 scenes; smaller lakes take less, since more of their rows are alike.
_BYTES_PER_SCENE = 55_000

# Tables that say something about the lake, not about scenes.
_ABOUT_THE_LAKE = ("snapshots", "releases")

_SECONDS = {
    "capture": 4.0,
    "captions": 2.0,
    "candidates": 9.0,
    "selection": 7.0,
    "optimization": 40.0,
    "micro_scenes": 0.1,
    "navigation": 8.0,
    "fidelity": 3.0,
    "exports": 7.0,
}
"""Mean time of a stage on a scene [s]; of one that is not here, `_ANY_SECONDS`."""

_ANY_SECONDS = 1.0

_RERUN = ("optimization", "exports")
"""Stages that ran twice."""


def generated_lake(scenes: int, seed: int = 0, progress: Callable[[str], None] | None = None) -> Lake:
    """A lake of generated scenes with 40 objects each, made once and kept in the cache of this machine.

    `progress` is told each table that is written (`steps` many, none when the lake is there already). Whoever commits to it
    takes a copy: `copied_lake`. The same scenes and seed give the same rows.

    Raises:
        InputError: the disk has no room for it.
    """
    needed, parent = scenes * _BYTES_PER_SCENE, cache_folder() / "bench"
    parent.mkdir(parents=True, exist_ok=True)
    if needed > shutil.disk_usage(parent).total:
        raise _no_room(parent, scenes)
    folder = parent / f"lake-{scenes}-{seed}-{_fingerprint(scenes, seed)[:16]}"
    if not (folder / MARKER).exists():
        _remove_outdated(parent)
        if 1.1 * needed > shutil.disk_usage(parent).free:
            raise _no_room(parent, scenes)
        with _whole(folder) as part:
            _generate(part, scenes, seed, progress or (lambda table: None))
    os.utime(folder / MARKER)  # in use: see _remove_outdated
    return Lake.open(folder)


def steps() -> int:
    """How many times `generated_lake` tells its progress."""
    return len(_queries())


def copied_lake(lake: Lake, folder: Path) -> Lake:
    """A copy of a local lake that may be written to, in a new folder of the same file system; data files are shared by hard links."""

    def copied(source: str, target: str) -> None:
        if source.endswith(".parquet"):  # never changed once they are there
            os.link(source, target)
        else:
            shutil.copyfile(source, target)

    shutil.copytree(lake.address, folder, copy_function=copied)
    return Lake.open(folder)


def _no_room(folder: Path, scenes: int) -> InputError:
    free = shutil.disk_usage(folder).free
    problem = f"a lake of {scenes:,} scenes takes {scenes * _BYTES_PER_SCENE / 1e9:,.1f} GB, {free / 1e9:,.1f} GB are free"
    return InputError(folder, "", problem, "set METASCENES_CACHE to a folder with room, or take fewer scenes")


def _generate(folder: Path, scenes: int, seed: int, progress: Callable[[str], None]) -> None:
    """Write the lake into an empty folder."""
    parts = _parts(scenes)
    storage = storage_at(folder)
    tables = DeltaTables(storage)
    queries = _queries()

    largest_first = sorted(queries, key=lambda name: _LARGEST.index(name) if name in _LARGEST else len(_LARGEST))
    waiting = deque(largest_first)
    versions: dict[str, list[int | None]] = {}

    def write() -> None:
        with _connection(scenes, seed, parts) as connection:
            while waiting:
                table = TABLES[waiting.popleft()]
                writer = tables.writer(table, None, lambda: None)
                versions[table.name] = []
                for number in range(1, len(parts) + 1):
                    connection.execute(f"SET VARIABLE part = {number}")
                    if table.name in ("assets", "texture_charts"):
                        connection.execute((_HERE / "named.sql").read_text())
                    rows = connection.sql(_typed(connection, table, queries[table.name])).to_arrow_reader(50_000)
                    writer.append(rows.cast(nullable(table.arrow_schema)))
                    versions[table.name].append(writer.version)
                progress(table.name)

    _picks(scenes, seed)  # once, not in both
    with ThreadPoolExecutor(2) as threads:  # each keeps a core busy
        for made in [threads.submit(write), threads.submit(write)]:
            made.result()
    snapshots = [
        Snapshot(
            snapshot_id=number,
            created_at=datetime(2026, 1, number, tzinfo=UTC),
            tables=tuple(f"{name}={versions[name][number - 1]}" for name in sorted(versions)),
            note="generated",
        )
        for number in range(1, len(parts) + 1)
    ]
    tables.writer(TABLES["snapshots"], None, lambda: None).append(rows_to_arrow(snapshots, Snapshot))
    storage.create(MARKER, json.dumps({"format": FORMAT}).encode())
    for number in range(1, len(parts) + 1):
        release = _release(Lake.open(folder), number)
        storage.create(f"{folder_of(release.name)}/{RECORD}", json.dumps(record_fields(release)).encode())


_LARGEST = (
    "selections",
    "candidates",
    "assets",
    "instances",
    "placements",
    "masks",
    "frames",
    "certificates",
    "export_checks",
    "stage_runs",
)
"""Tables that take longest, in this order: the last ones to be written are small, so that no core waits."""


def _release(lake: Lake, snapshot_id: int) -> Release:
    """What the release of a snapshot says. Its folder of plain Parquet is not made: it would be the lake once more."""
    with lake.snapshot(snapshot_id).connect() as connection:

        def count(text: str) -> int:
            return int(connection.sql(f"SELECT count({text}").fetchall()[0][0])

        rows = {name: count(f"*) FROM {quoted(name)}") for name in sorted(TABLES) if name not in _ABOUT_THE_LAKE}
        return Release(
            name=f"v{snapshot_id}",
            snapshot_id=snapshot_id,
            created_at=datetime(2026, 1, snapshot_id, 12, tzinfo=UTC),
            notes="generated",
            code_version="generated",
            scenes=rows["scenes"],
            rooms=rows["splits"],
            objects=count("*) FROM instances WHERE NOT is_structure"),
            categories=count("DISTINCT category) FROM instances WHERE NOT is_structure"),
            assets=rows["assets"],
            placed_objects=rows["placements"],
            episodes=rows["episodes"],
            row_counts=tuple(f"{name}={number}" for name, number in rows.items()),
            erased_at=(),
        )


def _parts(scenes: int) -> list[int]:
    """First scenes of the snapshots; a multiple of ten, so that no room is divided."""
    ends = [int(scenes * share) // 10 * 10 for share in SHARES[:-1]]
    return sorted({0, *ends})


@contextlib.contextmanager
def _connection(scenes: int, seed: int, parts: list[int]) -> Iterator[Any]:
    """A DuckDB connection with what the queries of the rows need."""
    import duckdb

    with duckdb.connect(":memory:") as connection:
        connection.execute("SET threads = 1; SET TimeZone = 'UTC'; SET preserve_insertion_order = true")
        # Joins as they are written keep the order of the rows: the other side is always small.
        connection.execute("SET disabled_optimizers = 'join_order,build_side_probe_side'")
        rules = [
            {"format": name, "rule": rule, "place": place, "rules": len(names)}
            for name, names in _rules().items()
            for place, rule in enumerate(names)
        ]  # fmt: skip
        variables = {"scenes": scenes, "seed": seed, "parts": parts, "rules": rules, "runs": _runs()}
        for name, value in {**variables, "formats": sorted(EXPORT_FORMATS), "policies": list(POLICIES)}.items():
            connection.execute(f"SET VARIABLE {name} = {_sql(value)}")
        picks, library = _picks(scenes, seed)
        connection.register("pickable", picks)
        connection.execute("CREATE TABLE picks AS FROM pickable")
        connection.execute((_HERE / "prelude.sql").read_text())
        connection.register("shared", library)
        connection.execute((_HERE / "library.sql").read_text())
        yield connection


def _typed(connection: Any, table: Table, query: str) -> str:
    """A query with the table's columns in their order and types; columns that it does not give are null."""
    given = set(connection.sql(query).columns)
    cells = [
        f"CAST({quoted(c.name) if c.name in given or not c.nullable else 'NULL'} AS {sql_type(c.type)}) AS {quoted(c.name)}"
        for c in table.columns
    ]  # fmt: skip
    return f"SELECT {', '.join(cells)} FROM ({query})"


def _queries() -> dict[str, str]:
    """What the rows of a table are, by name of the table, in the order of the data path."""
    files = {path.stem: path for path in (_HERE / "rows").glob("*.sql")}
    asked = {name: table for name, table in TABLES.items() if name not in _ABOUT_THE_LAKE}
    return {name: files[name].read_text().strip() if name in files else _made_up(table) for name, table in asked.items()}


def _made_up(table: Table) -> str:
    """Rows from the schema alone: one for each object or scene that the key names, a single one where it names neither."""
    of_each = "objects_now" if "instance_id" in table.key else "scenes_now"
    which = "" if "scene_id" in table.key else " WHERE scene = 0"
    row = sample(table.record)
    keys = {"scene_id", "instance_id"} & set(table.key)
    values = {column.name: getattr(row, column.name) for column in table.columns if column.name not in keys}
    cells = [*sorted(keys), *(f"{_sql(value)} AS {quoted(name)}" for name, value in values.items() if value is not None)]
    return f"SELECT {', '.join(cells)} FROM {of_each}{which}"


@functools.cache
def _picks(scenes: int, seed: int) -> tuple[pa.Table, pa.Table]:
    """What an object may be: 65,536 equally likely picks of a category, and the library that its candidates come from.

    How often a category occurs falls with its rank as words do in a language; volumes are log-normal.
    """
    from tasks.captions.physics import materials, table
    from tasks.capture.labels import NYU40, STRUCTURE, label_map

    rng = np.random.default_rng([seed, 1])
    known = table()
    nyu40 = {category: number for category, number in sorted(label_map().entries.values()) if number not in STRUCTURE}
    common = [name for name in known if name in nyu40]
    rare = sorted(nyu40.keys() - set(common))
    names = [*common, *(rare[i] for i in rng.permutation(len(rare)))]
    shares = 1 / (np.arange(len(names)) + 2.7) ** 1.1
    ends = np.round(np.cumsum(shares / shares.sum()) * _PICKS).astype(int)
    counts = np.diff(ends, prepend=0)
    sizes = np.maximum(1, np.round(counts / _PICKS * max(100, scenes)).astype(int))
    starts = np.cumsum(sizes) - sizes
    ratios = np.exp(rng.normal(0, 0.4, (len(names), 3)))
    ratios /= np.cbrt(ratios.prod(axis=1, keepdims=True))
    rows = [known.get(name) for name in names]
    material_names = [row.materials[0][0] if row else "wood" for row in rows]
    columns: dict[str, Any] = {
        "category": names,
        "nyu40_id": [nyu40[name] for name in names],
        "nyu40_label": [NYU40[nyu40[name]] for name in names],
        "log_volume": np.clip(rng.normal(np.log(0.03), 1.6, len(names)), np.log(0.0005), np.log(1.5)),
        "log_spread": rng.uniform(0.3, 0.9, len(names)),
        "ratio_x": ratios[:, 0],
        "ratio_y": ratios[:, 1],
        "ratio_z": ratios[:, 2],
        "library_start": starts,
        "library_count": sizes,
        "body_type": [row.body_type if row else "rigid" for row in rows],
        "density": [float(row.density_kg_m3) if row else 650.0 for row in rows],
        "solid_fraction": [float(row.solid_fraction) if row else 0.1 for row in rows],
        "friction": [float(row.friction) if row else 0.4 for row in rows],
        "restitution": [float(row.restitution) if row else 0.3 for row in rows],
        "material": material_names,
        "density_low": [float(materials()[material].density_min_kg_m3) for material in material_names],
        "density_high": [float(materials()[material].density_max_kg_m3) for material in material_names],
    }
    categories = pa.table(columns)
    picks = categories.take(np.repeat(np.arange(len(names)), counts)).append_column("pick", pa.array(range(_PICKS), pa.int64()))
    library = categories.select(["category", "log_volume", "log_spread"]).take(np.repeat(np.arange(len(names)), sizes))
    return picks, library.append_column("library_index", pa.array(range(library.num_rows), pa.int64()))


def _rules() -> dict[str, list[str]]:
    """Names of the export rules by format, sorted."""
    from tasks.exports.formats import FORMATS

    return {format_.name: sorted({*format_.rules, "complete"}) for format_ in sorted(FORMATS, key=lambda format_: format_.name)}


def _runs() -> list[dict[str, Any]]:
    """Executions of the stages on a scene: version 1 made its rows, 0 is older, 2 a failed attempt after it."""
    from tasks.pipeline import SCENE_STAGES, upstream

    rows = []
    for number, stage in enumerate(SCENE_STAGES):
        reads = [above.name for above in upstream(stage) if above in SCENE_STAGES]
        made = [TABLES[name] for name in stage.writes if not (_HERE / "rows" / f"{name}.sql").exists()]
        of_each = {
            "by_object": [table.name for table in made if "instance_id" in table.key],
            "by_scene": [table.name for table in made if "instance_id" not in table.key and "scene_id" in table.key],
        }
        versions = {1, *([0] if stage.name in _RERUN else []), *([2] if stage.name == "exports" else [])}
        rows += [
            {
                "stage": stage.name, "reads": reads, "seconds": _SECONDS.get(stage.name, _ANY_SECONDS), "number": number,
                "version": version, **of_each,
            }
            for version in sorted(versions)
        ]  # fmt: skip
    return rows


def _sql(value: Any) -> str:
    """A value as SQL."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_sql(name)}: {_sql(item)}" for name, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_sql, value))}]" + ("" if value else "::VARCHAR[]")
    if isinstance(value, datetime):
        return f"'{value.isoformat()}'"
    return f"{value}::BIGINT" if isinstance(value, int) else repr(value)


def _fingerprint(scenes: int, seed: int) -> str:
    """Hash of what the rows and files depend on."""
    import duckdb

    key = hashlib.sha256(f"{duckdb.__version__} {delta.FILE_BYTES} {SHARES} {_rules()} {_runs()}".encode())
    for path in sorted([*_HERE.glob("*.sql"), *(_HERE / "rows").glob("*.sql")]):
        key.update(path.read_bytes())
    for shared in _picks(scenes, seed):
        key.update(str(shared.schema).encode())
        for column in shared.columns:
            key.update(str(pc.sum(pc.cast(column, pa.float64())) if not pa.types.is_string(column.type) else column.unique()).encode())
    for table in TABLES.values():
        key.update(str([(c.name, str(c.type)) for c in table.columns]).encode())
    return key.hexdigest()


@contextlib.contextmanager
def _whole(folder: Path) -> Iterator[Path]:
    """A folder beside `folder` that takes its name at the end; removed when anything goes wrong."""
    part = folder.with_name(f"part-{new_token()}")
    try:
        yield part
        with contextlib.suppress(FileExistsError, OSError):  # another process was faster
            part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _remove_outdated(folder: Path) -> None:
    """Remove lakes that nobody used for a week, and what was left of killed runs."""
    for path in folder.glob("*"):
        used = path / MARKER if (path / MARKER).exists() else path
        if path.is_dir() and time.time() - used.stat().st_mtime > 7 * 86400:
            shutil.rmtree(path, ignore_errors=True)
