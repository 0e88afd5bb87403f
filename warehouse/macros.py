"""Questions with parameters: one SQL macro per question, kept as one file each in `macros/`.

A file's name is its macro's name. It begins as a view's file does (question, version, note) and goes on with one
`CREATE MACRO name(parameters) AS ...`: an expression, or `TABLE` and a query over tables and views.
"""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from importlib import resources


@dataclasses.dataclass(frozen=True)
class Header:
    """What the comment at the head of an SQL file says, and the statement below it."""

    question: str
    version: int
    note: str
    body: str


@dataclasses.dataclass(frozen=True)
class Macro:
    """A question with parameters. `parameters` are as SQL has them, defaults included (`n := 50`).

    `body` is the query of a table macro, which stands in FROM, or the expression of a scalar one.
    """

    name: str
    question: str
    note: str
    parameters: tuple[str, ...]
    is_table: bool
    body: str
    version: int

    @property
    def comment(self) -> str:
        """Question, version and note in one line, as SQL shows it."""
        return comment(self.question, self.version, self.note)

    @property
    def signature(self) -> str:
        """Name and parameters, as SQL has them."""
        return f"{self.name}({', '.join(self.parameters)})"

    @property
    def statements(self) -> list[str]:
        """SQL that creates and comments the macro."""
        table = "TABLE " if self.is_table else ""
        kind = "MACRO TABLE" if self.is_table else "MACRO"
        return [
            f"CREATE OR REPLACE MACRO {self.signature} AS {table}{self.body}",
            f'COMMENT ON {kind} "{self.name}" IS {literal(self.comment)}',
        ]


@cache
def macros() -> tuple[Macro, ...]:
    """All macros, by name.

    Raises:
        ValueError: a file does not begin with its question and version, or is not one macro of its name.
    """
    folder = resources.files("warehouse") / "macros"
    files = sorted((entry for entry in folder.iterdir() if entry.name.endswith(".sql")), key=lambda entry: entry.name)
    return tuple(_parse(file.name.removesuffix(".sql"), file.read_text(encoding="utf-8")) for file in files)


@cache
def table_macros() -> frozenset[str]:
    """Names of the macros that stand in FROM."""
    return frozenset(macro.name for macro in macros() if macro.is_table)


def read_header(file: str, text: str) -> Header:
    """The comment at the head of an SQL file: question, version, note; and what is below it.

    Raises:
        ValueError: the first line asks no question, or the second states no version.
    """
    lines = text.strip().splitlines()
    header = []
    while lines and lines[0].startswith("--"):
        header.append(lines.pop(0).removeprefix("--").strip())
    if not header or not header[0].endswith("?"):
        raise ValueError(f"{file}: the first line must be a comment that asks a question")
    version = re.fullmatch(r"Version ([1-9][0-9]*)\.", header[1]) if len(header) > 1 else None
    if version is None:
        raise ValueError(f"{file}: the second line must be a comment that states the version, such as: Version 1.")
    return Header(header[0], int(version[1]), " ".join(header[2:]), "\n".join(lines).strip().removesuffix(";"))


def comment(question: str, version: int, note: str) -> str:
    """Question, version and note in one line."""
    return f"{question} Version {version}. {note}".strip()


def literal(text: str) -> str:
    """Text as an SQL literal."""
    return "'" + text.replace("'", "''") + "'"


def _parse(name: str, text: str) -> Macro:
    """The macro in one file."""
    header = read_header(f"macros/{name}.sql", text)
    found = _MACRO.fullmatch(header.body)
    if found is None or found["name"] != name:
        raise ValueError(f"macros/{name}.sql: must be one statement: CREATE MACRO {name}(...) AS ...")
    parameters = tuple(part.strip() for part in found["parameters"].split(",") if part.strip())
    return Macro(name, header.question, header.note, parameters, found["table"] is not None, found["body"], header.version)


_MACRO = re.compile(r"CREATE MACRO (?P<name>\w+)\((?P<parameters>[^()]*)\) AS (?P<table>TABLE\s+)?(?P<body>.+)", re.DOTALL)
