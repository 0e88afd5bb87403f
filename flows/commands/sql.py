"""`metascenes sql`: questions to the lake."""

from __future__ import annotations

import sys
from typing import Literal

import click

from flows.commands.options import chosen_snapshot, existing_lake, lake_option, snapshot_options


@click.command("sql", short_help="Ask the lake a question in SQL; reads only.")
@click.argument("statement", required=False)
@click.option(
    "--output", type=click.Choice(["table", "csv", "json", "parquet"]), default="table", show_default=True, help="Form of the answer."
)
@click.option("--list", "listing", is_flag=True, help="List tables and views with what they answer.")
@snapshot_options
@lake_option
def command(
    statement: str | None,
    output: Literal["table", "csv", "json", "parquet"],
    listing: bool,
    snapshot_id: int | None,
    release: str | None,
    address: str,
) -> None:
    """Ask the lake a question in SQL. Only statements that read are let through.

    Example: metascenes sql "SELECT category, count(*) FROM instances GROUP BY ALL ORDER BY 2 DESC LIMIT 5"
    """
    from schemas.tables import TABLES
    from warehouse.sql import format_table, query
    from warehouse.views import listing as views

    if listing:
        for name, table in TABLES.items():
            print(f"table  {name:<22} {table.description}")
        for name, question in views():
            print(f"view   {name:<22} {question}")
        return
    if statement is None:
        raise click.UsageError('give a statement, or --list. Example: metascenes sql "SELECT * FROM scenes"')
    lake = existing_lake(address)
    answer = format_table(query(lake.snapshot(chosen_snapshot(lake, snapshot_id, release)), statement), output)
    if isinstance(answer, bytes):
        sys.stdout.buffer.write(answer)
    else:
        sys.stdout.write(answer if answer.endswith("\n") else answer + "\n")
