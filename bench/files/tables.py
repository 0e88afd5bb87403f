"""The report of the corpus for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bench.files.comparison import ASPECTS
from bench.files.report import VERDICTS
from bench.tables import add_row, goals_table, headline, table_of

if TYPE_CHECKING:
    from rich.console import Console


def print_files(report: Mapping[str, Any], console: Console) -> None:
    """Counts by reader, aspects that no judge checked, every verdict other than agreement with its reason, and judges that disagree."""
    console.print(headline(report["machine"], report["config"]["seed"], 1), soft_wrap=True)
    for judge, remedy in report["missing"].items():
        console.print(f"without {judge}: {remedy}", soft_wrap=True)
    rows = report["rows"]
    counts = Counter((row["reader"], row["verdict"]) for row in rows)
    unchecked = Counter((row["reader"], aspect) for row in rows for aspect in row["unchecked"])
    aspects = [aspect for aspect in ASPECTS if any(aspect in row["unchecked"] for row in rows)]
    columns = [("reader", False), *((verdict, True) for verdict in VERDICTS), *((f"{aspect} unchecked", True) for aspect in aspects)]
    table = table_of(f"{report['files']} files of {report['config']['corpus']}", *columns)
    for reader in dict.fromkeys(row["reader"] for row in rows):
        figures = [*(counts[reader, verdict] for verdict in VERDICTS), *(unchecked[reader, aspect] for aspect in aspects)]
        add_row(table, reader, *map(str, figures))
    console.print(table)
    remarks = table_of("verdicts other than agreement", ("file", False), ("reader", False), ("verdict", False), ("reason", False))
    for row in rows:
        if row["verdict"] != "agrees":
            add_row(remarks, row["file"], row["reader"], row["verdict"], row["reason"][:200])
    console.print(remarks)
    differing = table_of("judges that disagree", ("file", False), ("in", False))
    for name, aspects in report["judges_differ"].items():
        add_row(differing, name, ", ".join(aspects))
    if report["judges_differ"]:
        console.print(differing)
    console.print(goals_table(report["goals"]))
