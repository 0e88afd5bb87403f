"""Forms of an answer: a table for people, one with a line per column, CSV, JSON, JSON Lines and Parquet, written batch by batch.

Values survive the way there and back: numbers are written with as many digits as they need, NULL is told from the empty
text, lists and structs are JSON, times are ISO 8601 in UTC. Text is made by column, not by value: four million rows
take seconds.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from typing import Any, BinaryIO, Literal

import pyarrow as pa
import pyarrow.compute as pc

from schemas.errors import InputError
from schemas.text import escaped
from schemas.wording import counted
from warehouse.questions.sql import Answer

Output = Literal["table", "expanded", "csv", "json", "jsonl", "parquet"]
OUTPUTS: tuple[Output, ...] = ("table", "expanded", "csv", "json", "jsonl", "parquet")

# Characters beyond JSON's own that are written out: those that turn the reading direction over, hide or command a terminal.
_COMMANDS = r"[\x7f\p{Cc}\p{Cf}\p{Zl}\p{Zp}]"

_TEXT = pa.large_string()  # a batch of wide rows may hold more than 2 GB


def write_answer(answer: Answer, output: Output, sink: BinaryIO, limit: int | None = None) -> int:
    """Write an answer as UTF-8 text or Parquet; how many rows it has.

    `limit` is how many rows a table, also an expanded one, shows at most; what else there is is counted, and said below it. Other
    outputs have all rows.

    Raises:
        InputError: there is no such output, or what computes the rows fails.
    """
    match output:
        case "table":
            return _write_table(answer, sink, limit)
        case "expanded":
            return _write_expanded(answer, sink, limit)
        case "csv":
            sink.write((",".join(_csv_text(pa.array(answer.schema.names, _TEXT)).to_pylist()) + "\n").encode())
            return _write_lines(answer, sink, _csv_rows, "", "\n")
        case "jsonl":
            return _write_lines(answer, sink, _json_rows, "", "\n")
        case "json":
            sink.write(b"[")
            count = _write_lines(answer, sink, _json_rows, ",\n", "")
            sink.write(b"\n]\n" if count else b"]\n")
            return count
        case "parquet":
            return _write_parquet(answer, sink)
    raise InputError("output", str(output), "there is no such output", f"choose one of {', '.join(OUTPUTS)}")


def plain_text(values: pa.Array) -> pa.Array:
    """Values as text, lists and structs as JSON, binary as hexadecimal digits; NULL stays NULL."""
    kind = values.type
    if isinstance(kind, pa.BaseExtensionType):
        return plain_text(values.storage)
    if pa.types.is_dictionary(kind):
        return plain_text(values.dictionary_decode())
    if _is_nested(kind):
        return json_text(values)
    if pa.types.is_floating(kind):
        # Arrow gives the fewest digits that are read as the same number, but 1 for 1.0.
        return pc.replace_substring_regex(pc.cast(values, _TEXT), r"^(-?[0-9]+)$", r"\1.0")
    if pa.types.is_timestamp(kind):
        iso = pc.replace_substring(pc.cast(values.cast(pa.timestamp(kind.unit)), _TEXT), " ", "T")  # of UTC, whatever the zone
        short = pc.replace_substring_regex(iso, r"\.0+$", "")
        return _enclosed("", short, "+00:00") if kind.tz else short
    if pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
        return pa.array([None if value is None else value.hex() for value in values.to_pylist()], _TEXT)
    return pc.cast(values, _TEXT)


def json_text(values: pa.Array) -> pa.Array:
    """Values as JSON; NULL stays NULL. What JSON has no number for is the text NaN, Infinity or -Infinity."""
    kind = values.type
    if isinstance(kind, pa.BaseExtensionType):
        return json_text(values.storage)
    if pa.types.is_dictionary(kind):
        return json_text(values.dictionary_decode())
    if _is_list(kind):
        return _json_list(values)
    if pa.types.is_struct(kind):
        parts = [json_text(part) for part in values.flatten()]
        return _where(values, _json_object([field.name for field in kind], parts, len(values)))
    text = plain_text(values)
    if pa.types.is_floating(kind):
        for written, name in (("nan", '"NaN"'), ("inf", '"Infinity"'), ("-inf", '"-Infinity"')):
            text = pc.if_else(pc.equal(text, written), name, text)
        return text
    if pa.types.is_integer(kind) or pa.types.is_decimal(kind) or pa.types.is_boolean(kind) or pa.types.is_null(kind):
        return text
    return _enclosed('"', _escaped(text), '"')


def _json_list(values: pa.Array) -> pa.Array:
    values = values.cast(pa.large_list(values.type.value_type))
    lengths = pc.fill_null(pc.list_value_length(values), 0).to_numpy(zero_copy_only=False)
    offsets = pa.array([0, *itertools.accumulate(lengths.tolist())], pa.int64())
    items = pc.fill_null(json_text(values.flatten()), "null")
    return _where(values, _enclosed("[", pc.binary_join(pa.LargeListArray.from_arrays(offsets, items), pa.scalar(", ", _TEXT)), "]"))


def _json_object(names: Sequence[str], parts: Sequence[pa.Array], count: int) -> pa.Array:
    """One JSON object a row."""
    if not parts:
        return pa.array(["{}"] * count, _TEXT)
    heads = [f"{', ' if index else '{'}{escaped(json.dumps(name, ensure_ascii=False))}: " for index, name in enumerate(names)]
    pieces = list(itertools.chain.from_iterable(zip(heads, parts, strict=True)))
    return _joined(*pieces, "}", null="null")


def _escaped(text: pa.Array) -> pa.Array:
    """Text as it stands between the quotation marks of JSON."""
    text = pc.replace_substring(pc.replace_substring(text, "\\", "\\\\"), '"', '\\"')
    if pc.any(pc.match_substring_regex(text, "[\x00-\x1f]")).as_py():
        for code in range(32):
            text = pc.replace_substring(text, chr(code), json.dumps(chr(code))[1:-1])
    if pc.any(pc.match_substring_regex(text, _COMMANDS)).as_py():
        text = pa.array([value if value is None else escaped(value) for value in text.to_pylist()], _TEXT)
    return text


def _csv_text(text: pa.Array) -> pa.Array:
    """Text as a field of CSV: in quotation marks where it needs them, and where it is empty, for NULL is nothing at all."""
    special = pc.match_substring_regex(text, r'^$|[",\n\r]|^\s|\s$')
    if not pc.any(special).as_py():
        return text
    return pc.if_else(special, _enclosed('"', pc.replace_substring(text, '"', '""'), '"'), text)


def _csv_rows(batch: pa.RecordBatch) -> pa.Array:
    fields = []
    for column in batch.columns:
        text = plain_text(column)
        has_words = not (pa.types.is_primitive(column.type) or pa.types.is_null(column.type))
        fields.append(_csv_text(text) if has_words else text)
    separated = list(itertools.chain.from_iterable((",", field) for field in fields))[1:]
    return _joined(*separated, null="")


def _json_rows(batch: pa.RecordBatch) -> pa.Array:
    return _json_object(batch.schema.names, [json_text(column) for column in batch.columns], batch.num_rows)


def _write_lines(answer: Answer, sink: BinaryIO, rows: Callable[[pa.RecordBatch], pa.Array], before: str, after: str) -> int:
    """Write a line per row with something before and after it, but a comma not before the first; how many."""
    count = 0
    for batch in answer.batches:
        if batch.num_rows:
            data = _contents(_joined(before, rows(batch), after, null=""))
            sink.write(data if count or not before else data[1:])
            count += batch.num_rows
    return count


def _write_parquet(answer: Answer, sink: BinaryIO) -> int:
    import pyarrow.parquet as pq

    count = 0
    with pq.ParquetWriter(_Counted(sink), answer.schema, compression="zstd") as writer:
        for batch in answer.batches:
            writer.write_batch(batch)
            count += batch.num_rows
    return count


def _write_table(answer: Answer, sink: BinaryIO, limit: int | None, widest: int = 60) -> int:
    """Rows in columns for a terminal: numbers to the right, long cells cut, the row count below."""
    shown, count = [], 0
    for batch in answer.batches:
        kept = batch.num_rows if limit is None else max(0, min(batch.num_rows, limit - count))
        if kept:
            shown.append(batch.slice(0, kept))
        count += batch.num_rows
    data = pa.Table.from_batches(shown, answer.schema)
    columns = [[cell if len(cell) <= widest else cell[: widest - 1] + "…" for cell in _cells(column)] for column in data.columns]
    names = [escaped(" ".join(name.split())) for name in data.column_names]
    widths = [max([len(name), *map(len, column)]) for name, column in zip(names, columns, strict=True)]
    types = pa.types
    right = [types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind) for kind in data.schema.types]

    def line(cells: Sequence[str]) -> str:
        return "  ".join(c.rjust(w) if r else c.ljust(w) for c, w, r in zip(cells, widths, right, strict=True)).rstrip()

    rule = "  ".join("-" * width for width in widths)
    body = [line(row) for row in zip(*columns, strict=True)]
    sink.write(("\n".join([line(names), rule, *body, _last_line(data.num_rows, count)]) + "\n").encode())
    return count


def _write_expanded(answer: Answer, sink: BinaryIO, limit: int | None) -> int:
    """A line per column for each row, no cell cut, the row count below."""
    names = [escaped(" ".join(name.split())) for name in answer.schema.names]
    width = max(map(len, names), default=0)
    shown = count = 0
    for batch in answer.batches:
        kept = batch.slice(0, batch.num_rows if limit is None else max(0, limit - shown))
        columns = [_cells(pa.chunked_array([column])) for column in kept.columns]
        for number, row in enumerate(zip(*columns, strict=True), shown + 1):
            lines = [f"{name.ljust(width)}  {cell}".rstrip() for name, cell in zip(names, row, strict=True)]
            sink.write(("\n".join([f"[row {number}]", *lines]) + "\n").encode())
        shown += kept.num_rows
        count += batch.num_rows
    sink.write(f"{_last_line(shown, count)}\n".encode())
    return count


def _last_line(shown: int, count: int) -> str:
    rows = counted(count, "row")
    return f"({rows})" if shown == count else f"(the first {shown} of {rows})"


def _cells(column: pa.ChunkedArray) -> list[str]:
    """Values as one line of text each; numbers with the six digits that people read."""
    if pa.types.is_floating(column.type):
        return ["" if value is None else f"{value:.6g}" for value in column.to_pylist()]
    texts = itertools.chain.from_iterable(plain_text(chunk).to_pylist() for chunk in column.chunks)
    return ["" if text is None else escaped(" ".join(text.split())) for text in texts]


class _Counted:
    """A stream that can only be written to, as Parquet's writer wants it: it asks where it is."""

    closed = False

    def __init__(self, sink: BinaryIO) -> None:
        self._sink, self._at = sink, 0

    def write(self, data: Any) -> int:
        """Write bytes; how many."""
        view = memoryview(data)
        self._sink.write(view)
        self._at += view.nbytes
        return view.nbytes

    def tell(self) -> int:
        """Bytes written so far."""
        return self._at

    def flush(self) -> None:
        """Pass on what is held back."""
        self._sink.flush()

    def close(self) -> None:
        """Leave the stream to its owner."""


def _is_list(kind: pa.DataType) -> bool:
    return pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)


def _is_nested(kind: pa.DataType) -> bool:
    return _is_list(kind) or pa.types.is_struct(kind)


def _joined(*parts: Any, null: str) -> pa.Array:
    """Texts put together row by row, with something for NULL."""
    made = [part if isinstance(part, pa.Array) else pa.scalar(part, _TEXT) for part in parts]
    return pc.binary_join_element_wise(*made, pa.scalar("", _TEXT), null_handling="replace", null_replacement=null)


def _enclosed(before: str, text: pa.Array, after: str) -> pa.Array:
    """Texts between two others; NULL stays NULL."""
    return pc.binary_join_element_wise(*(pa.scalar(before, _TEXT), text, pa.scalar(after, _TEXT)), pa.scalar("", _TEXT))


def _where(values: pa.Array, text: pa.Array) -> pa.Array:
    """`text` where there is a value, else NULL."""
    return pc.if_else(values.is_valid(), text, pa.scalar(None, _TEXT))


def _contents(text: pa.Array) -> memoryview:
    """The bytes of all texts, one after the other, as they lie in memory."""
    offsets = memoryview(text.buffers()[1]).cast("q")
    return memoryview(text.buffers()[2])[offsets[text.offset] : offsets[text.offset + len(text)]]
