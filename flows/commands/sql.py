"""`metascenes sql`: questions to the lake."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flows.commands.options import chosen_snapshot, existing_lake, lake_option, snapshot_options

if TYPE_CHECKING:
    from flows.questions.prompt import SqlPrompt
    from warehouse.questions.answers import Output

_FORMS: dict[str, Output] = {".csv": "csv", ".json": "json", ".jsonl": "jsonl", ".ndjson": "jsonl", ".parquet": "parquet", ".txt": "table"}
"""Forms of an answer by the ending of the file that takes it."""

_TABLE_ROWS = 1000
"""Rows that a terminal shows where nobody says how many."""


@click.command("sql", short_help="Ask the lake a question in SQL; reads only.")
@click.argument("statement", required=False)
@click.option("--file", "source", type=click.Path(dir_okay=False), help="Read the statement from a file; - is standard input.")
@click.option(
    "--output",
    type=click.Choice(["table", "expanded", "csv", "json", "jsonl", "parquet"]),
    help="Form of the answer; by default what the ending of --out says, else a table.",
)
@click.option(
    "--attach",
    "files",
    multiple=True,
    metavar="NAME=FILE",
    help="Rows of a CSV, JSON or Parquet file as the relation NAME; may be repeated.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Write the answer into a file, whole or not at all.")
@click.option("--force", is_flag=True, help="Let --out replace a file.")
@click.option(
    "--limit", type=click.IntRange(0), help="Rows that a table shows, expanded or not; 0 shows all.  [default: 1000; in a file all]"
)
@click.option("--timeout", type=click.FloatRange(0), default=600, show_default=True, help="Seconds until it is ended; 0 waits for ever.")
@click.option("--memory", type=click.FloatRange(0.5), default=3, show_default=True, help="GB that it may use.")
@click.option("--json", "as_json", is_flag=True, help="The same as --output json; --list gives JSON, too.")
@click.option("--list", "listing", is_flag=True, help="List tables, views and macros with versions and what they answer.")
@snapshot_options
@lake_option
def command(
    statement: str | None,
    source: str | None,
    output: Output | None,
    files: tuple[str, ...],
    out: Path | None,
    force: bool,
    limit: int | None,
    timeout: float,
    memory: float,
    as_json: bool,
    listing: bool,
    snapshot_id: int | None,
    release: str | None,
    address: str,
) -> None:
    """Ask the lake a question in SQL. Only statements that read are let through. A STATEMENT of - is read from standard input.

    Without a STATEMENT, a terminal shows a prompt: Tab completes, the history is kept, `\\?` lists what else it understands. From what
    is no terminal, statements that end with a semicolon are read, and answered up to the first error.

    Example: metascenes sql "SELECT category, count(*) FROM instances WHERE NOT is_structure GROUP BY ALL"

    Example: metascenes sql "FROM instances" --out instances.parquet
    """
    from flows.questions.bounds import Bounds, whole_file, write_bounded
    from flows.questions.prompt import SqlPrompt
    from flows.terminal import output as terminal_output
    from schemas.wording import counted
    from warehouse.questions.attached import attached

    if as_json and output not in (None, "json"):
        raise click.UsageError(f"--json contradicts --output {output}")
    output = "json" if as_json else output
    if listing:
        _list(output)
        return
    named = _named(files)
    text = _statement(statement, source)
    if text is None and (out is not None or output == "parquet"):
        raise click.UsageError(
            f"{'--out' if out else '--output parquet'} takes the answer to one statement: give it, or - for standard input"
        )
    form = output or (_form_of(out) if out and not out.is_dir() else "table")
    most = limit if limit is not None else 0 if out else _TABLE_ROWS
    if form == "parquet" and out is None and sys.stdout.isatty():
        raise click.UsageError("Parquet is not for a terminal: name a file with --out")
    lake = existing_lake(address)
    reader = lake.snapshot(chosen_snapshot(lake, snapshot_id, release))
    bounds = Bounds(timeout, memory)
    with contextlib.ExitStack() as stack:
        relations = stack.enter_context(attached(named)) if named else ()
        if text is None:
            _ask_on(SqlPrompt(reader, form, most, bounds, relations))
            return
        sink = stack.enter_context(whole_file(out, force, lake.storage.local_path(""))) if out else terminal_output()
        rows = write_bounded(sink, reader, text, form, most, bounds, relations)
    if out is not None:
        shown = f"the first {most} of " if form in ("table", "expanded") and 0 < most < rows else ""
        click.echo(f"{out}: {shown}{counted(rows, 'row')}", err=True)


def _named(files: tuple[str, ...]) -> dict[str, Path]:
    """Files by the names that they are to have."""
    named: dict[str, Path] = {}
    for text in files:
        name, sign, file = text.partition("=")
        if not sign or not file:
            raise click.UsageError(f"--attach {text} is not NAME=FILE, as in weights=weights.csv")
        if name in named:
            raise click.UsageError(f"--attach names {name} twice")
        named[name] = Path(file)
    return named


def _ask_on(prompt: SqlPrompt) -> None:
    """Statements from a terminal, or from whatever standard input is."""
    if sys.stdin.isatty() and sys.stdout.isatty():
        prompt.typed()
        return
    with io.TextIOWrapper(sys.stdin.buffer, "utf-8-sig") as lines:
        prompt.read(lines)


def _form_of(out: Path) -> Output:
    """What the ending of a file says."""
    from schemas.errors import InputError

    form = _FORMS.get(out.suffix.lower())
    if form is None:
        raise InputError(str(out), "--out", "has no ending that says what form to write", f"use one of {', '.join(_FORMS)}, or --output")
    return form


def _list(output: Output | None) -> None:
    """Every name that a statement can use."""
    from warehouse.questions.catalog import entries

    if output == "json":
        print(json.dumps([dataclasses.asdict(entry) for entry in entries()], indent=2, ensure_ascii=False))
        return
    width = max(len(entry.signature) for entry in entries())
    for entry in entries():
        version = f"v{entry.version}" if entry.version is not None else ""
        print(f"{entry.kind:<5}  {entry.signature:<{width}}  {version:<3}  {entry.text}")


def _statement(statement: str | None, source: str | None) -> str | None:
    """The statement, from wherever it is; None where none is named."""
    from schemas.budget import BUDGET
    from schemas.errors import InputError
    from schemas.files import read_file

    if statement is not None and source is not None:
        raise click.UsageError("give a statement or --file, not both")
    if statement is None and source is None:
        return None
    if statement is not None and statement != "-":
        return statement
    place = source or "-"
    try:
        data = sys.stdin.buffer.read() if place == "-" else read_file(Path(place), place, BUDGET.statement_bytes, "give a file with SQL")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(place, "", "this is no UTF-8 text", "give a file with SQL") from error
