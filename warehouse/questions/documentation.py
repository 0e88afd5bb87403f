"""What the schemas say, as SQL comments and as the table pages of the documentation."""

from __future__ import annotations

import pyarrow as pa

from schemas.record import Column, Table
from schemas.tables import TABLES
from warehouse.questions.quoting import literal, quoted
from warehouse.questions.renames import former_columns, move_out_of

_RULES = {
    "replace": "a scene's new rows take the place of its old ones",
    "append": "history is kept",
    "share": "shared by several scenes: inserted when absent, removed when no row of `{shared_by}` names the key any more",
}


def sql_type(arrow: pa.DataType) -> str:
    """The DuckDB type of an Arrow type."""
    if pa.types.is_list(arrow):
        return f"{sql_type(arrow.value_type)}[]"
    if pa.types.is_timestamp(arrow):
        return "TIMESTAMPTZ"
    return {pa.string(): "VARCHAR", pa.int64(): "BIGINT", pa.float64(): "DOUBLE", pa.bool_(): "BOOLEAN"}[arrow]


def comment_statements(table: Table) -> list[str]:
    """SQL that comments the view of a table and its columns."""
    name = quoted(table.name)
    statements = [f"COMMENT ON VIEW {name} IS {literal(table.description)}"]
    statements.extend(f"COMMENT ON COLUMN {name}.{quoted(column.name)} IS {literal(column.comment)}" for column in table.columns)
    return statements


def constraint(column: Column) -> str:
    """The constraint of a column in words; empty when there is none besides its type."""
    parts = []
    if column.values:
        parts.append("one of " + ", ".join(f"`{value}`" for value in column.values))
    if column.blob:
        parts.append("names a blob")
    elif column.pattern:
        parts.append(f"matches `{column.pattern}`".replace("|", "\\|"))
    if column.length is not None:
        parts.append(f"{column.length} values")
    if column.minimum is not None:
        parts.append(f"at least {column.minimum:g}")
    if column.maximum is not None:
        parts.append(f"at most {column.maximum:g}")
    if column.nullable:
        parts.append("may be missing")
    if column.volatile:
        parts.append("volatile")
    return "; ".join(parts)


def table_section(table: Table) -> str:
    """The section of a table in the documentation, Markdown."""
    rule = _RULES[table.rule].format(shared_by=table.shared_by)
    lines = [
        f"## `{table.name}`",
        "",
        table.description,
        "",
        f"Grain: {table.grain.replace('_', ' ')}. Key: {', '.join(f'`{name}`' for name in table.key)}. Rule: {rule}.",
        "",
        "| column | type | unit | constraint | description |",
        "|---|---|---|---|---|",
    ]
    before = {after: f" (before: `{old}`)" for old, after in former_columns(table.name).items()}
    for column in table.columns:
        described = column.description.replace("|", "\\|") + before.get(column.name, "")
        lines.append(f"| `{column.name}` | {sql_type(column.type)} | {column.unit} | {constraint(column)} | {described} |")
    move = move_out_of(table.name)
    if move is not None:
        moved = ", ".join(f"`{column}`" for column in move.columns)
        lines += [
            "",
            f"Now in [`{move.after}`](#{move.after}), and asked here as well, on every row of a scene, until the next version: {moved}.",
        ]
    return "\n".join(lines) + "\n"


def tables_page() -> str:
    """`docs/tables.md`: every table of the lake, by stage, Markdown."""
    parts = [
        "# Tables",
        "",
        "Generated from `schemas/`: do not edit. Columns that are marked volatile (times, hosts, attempts) may differ",
        "between two runs with the same result. What the stages write comes first, what the lake keeps about itself last.",
        "",
        "| table | stage | grain | rule | description |",
        "|---|---|---|---|---|",
    ]
    for table in TABLES.values():
        named = f"[`{table.name}`](#{table.name})"
        cells = [named, table.stage or "the lake", table.grain.replace("_", " "), table.rule, table.description]
        parts.append(f"| {' | '.join(cells)} |")
    return "\n".join(parts) + "\n\n" + "\n".join(table_section(table) for table in TABLES.values())
