"""The box plot of volumes, asked three ways: of the lake, of one Parquet file sorted by hand, and with pandas.

The figures are those of the 50 most frequent categories: how many objects, quartiles, whiskers, and how many lie beyond them.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from bench.warehouse.answers import CORES, MEMORY, keep_to_cores, time_query
from schemas.errors import InputError
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.questions import views
from warehouse.questions.quoting import listed, literal, quoted
from warehouse.tables.snapshot import read_files, relation

if TYPE_CHECKING:
    import pandas as pd

CATEGORIES = 50
"""Categories of the box plot."""

COLUMNS = ("category", "is_structure", "box_volume_m3")
"""What the figures are computed from."""

QUERY = f"SELECT * FROM volume_by_category WHERE frequency_rank <= {CATEGORIES} ORDER BY frequency_rank"

FIGURES = ("objects", "smallest_m3", "whisker_low_m3", "q1_m3", "median_m3", "q3_m3", "whisker_high_m3", "largest_m3", "outliers")


def time_volumes(address: str, runs: int) -> dict[str, Any]:
    """Seconds of the three ways, and whether they agree. Runs in a worker that did nothing else.

    `sorted` is a file sorted by category and volume, `by_key` one sorted by scene and object, as the lake's rows lie.

    Raises:
        InputError: pandas is not installed.
    """
    keep_to_cores(CORES)
    lake = Lake.open(address)
    reader = lake.snapshot()
    files = [lake.storage.duckdb_path(file) for file in reader.files("instances")]
    timings: dict[str, Any] = {}
    figures: dict[str, pa.Table] = {}
    with reader.connect({"memory_limit": MEMORY}) as connection:
        timings["lake"] = time_query(connection, "lake", QUERY, runs)
        figures["lake"] = connection.sql(QUERY).to_arrow_table()
    for name, order in (("sorted", "category, box_volume_m3"), ("by_key", "scene_id, instance_id")):
        with tempfile.TemporaryDirectory(prefix="bench-", dir=Path(address).parent) as folder:
            file = f"{folder}/instances.parquet"
            _sort_by_hand(files, file, order)
            with _over_file(file) as connection:
                timings[name] = time_query(connection, name, QUERY, runs)
                figures[name] = connection.sql(QUERY).to_arrow_table()
    times = []
    for _ in range(max(3, runs // 2)):
        clock = time.perf_counter()
        frame = boxes_by_pandas(files)
        times.append(time.perf_counter() - clock)
    figures["pandas"] = pa.Table.from_pandas(frame, preserve_index=False)
    timings["pandas_seconds"] = float(np.median(times))
    timings["differences"] = {name: differences(figures["lake"], other) for name, other in figures.items() if name != "lake"}
    return timings


def boxes_by_pandas(files: Sequence[str]) -> pd.DataFrame:
    """The figures of the box plot as pandas computes them, from the same columns of the same files.

    Raises:
        InputError: pandas is not installed.
    """
    pd = pandas_module()
    frame = pd.read_parquet(list(files), columns=list(COLUMNS))
    frame = frame[~frame["is_structure"]]
    volumes = frame.groupby("category")["box_volume_m3"]
    boxes = volumes.agg(objects="count", smallest_m3="min", largest_m3="max").reset_index()
    boxes = boxes.sort_values(["objects", "category"], ascending=[False, True]).head(CATEGORIES)
    quartiles = volumes.quantile([0.25, 0.5, 0.75]).unstack().set_axis(["q1_m3", "median_m3", "q3_m3"], axis=1)
    boxes = boxes.merge(quartiles, left_on="category", right_index=True)
    reach = 1.5 * (boxes["q3_m3"] - boxes["q1_m3"])
    fences = boxes.assign(low=boxes["q1_m3"] - reach, high=boxes["q3_m3"] + reach)[["category", "low", "high"]]
    fenced = frame.merge(fences, on="category")
    is_inside = fenced["box_volume_m3"].between(fenced["low"], fenced["high"])
    inside = fenced[is_inside].groupby("category")["box_volume_m3"].agg(["min", "max"])
    outliers = (~is_inside).groupby(fenced["category"]).sum()
    boxes = boxes.merge(inside, left_on="category", right_index=True).merge(
        outliers.rename("outliers"), left_on="category", right_index=True
    )
    boxes["whisker_low_m3"] = boxes[["q1_m3", "min"]].min(axis=1)
    boxes["whisker_high_m3"] = boxes[["q3_m3", "max"]].max(axis=1)
    return boxes[["category", *FIGURES]].reset_index(drop=True)


def differences(ours: pa.Table, theirs: pa.Table) -> int:
    """Figures that differ by more than rounding, of the same categories in the same order; all of them when those differ."""
    if ours["category"].to_pylist() != theirs["category"].to_pylist():
        return len(FIGURES) * max(ours.num_rows, theirs.num_rows)
    wrong = 0
    for name in FIGURES:
        first, other = (np.asarray(table[name].to_pylist(), dtype=float) for table in (ours, theirs))
        wrong += int((~np.isclose(first, other, rtol=1e-12, atol=0)).sum())
    return wrong


def ratios(figures: Mapping[str, Any]) -> dict[str, float]:
    """How often the lake's time fits into the others': `pandas`, and the lake's time in those of the files."""
    lake = figures["lake"].seconds
    return {
        "pandas": figures["pandas_seconds"] / lake,
        "sorted": lake / figures["sorted"].seconds,
        "by_key": lake / figures["by_key"].seconds,
    }  # fmt: skip


def pandas_module() -> Any:
    """The package pandas.

    Raises:
        InputError: it is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise InputError("pandas", "", "is not installed, and the box plot is to be compared with it", "pip install pandas") from None
    return pandas


def _sort_by_hand(files: Sequence[str], target: str, order: str) -> None:
    """Write one Parquet file with what the figures need, sorted."""
    import duckdb

    with duckdb.connect(":memory:", config={"memory_limit": MEMORY, "threads": CORES}) as connection:
        rows = f"SELECT scene_id, instance_id, {', '.join(COLUMNS)} FROM read_parquet([{listed(files)}]) ORDER BY {order}"
        connection.execute(f"COPY ({rows}) TO {literal(target)} (FORMAT parquet, COMPRESSION zstd)")


def _over_file(file: str) -> Any:
    """A DuckDB connection with the lake's views, on which `instances` is one file and every other table is empty."""
    import duckdb

    connection = duckdb.connect(":memory:", config={"memory_limit": MEMORY})
    for table in TABLES.values():
        body = relation(table, read_files([file]) if table.name == "instances" else None)
        connection.execute(f"CREATE VIEW {quoted(table.name)} AS {body}")
    views.install(connection)
    return connection
