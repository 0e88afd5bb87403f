"""Questions with parameters: one SQL macro per question, kept as one file each in `macros/`.

A file's name is its macro's name. It begins as a view's file does (question, version, note) and goes on with one
`CREATE MACRO name(parameters) AS ...`: an expression, or `TABLE` and a query over tables and views.
"""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from importlib import resources

from warehouse.questions.quoting import literal


@dataclasses.dataclass(frozen=True)
class Question:
    """What an SQL file answers, by the comment at its head. `note` says how to read the answer; often empty."""

    name: str
    question: str
    note: str
    version: int

    @property
    def comment(self) -> str:
        """Question, version and note in one line, as SQL shows it."""
        return f"{self.question} Version {self.version}. {self.note}".strip()


@dataclasses.dataclass(frozen=True)
class Macro(Question):
    """A question with parameters. `parameters` are as SQL has them, defaults included (`n := 50`).

    `body` is the query of a table macro, which stands in FROM, or the expression of a scalar one.
    """

    parameters: tuple[str, ...]
    is_table: bool
    body: str

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
    return tuple(_parse(name, text) for name, text in sql_files("macros"))


@cache
def table_macros() -> frozenset[str]:
    """Names of the macros that stand in FROM."""
    return frozenset(macro.name for macro in macros() if macro.is_table)


def sql_files(folder: str) -> list[tuple[str, str]]:
    """Name and text of every SQL file in a folder beside this module, by name."""
    entries = (resources.files("warehouse.questions") / folder).iterdir()
    return sorted((entry.name.removesuffix(".sql"), entry.read_text("utf-8")) for entry in entries if entry.name.endswith(".sql"))


def read_header(file: str, text: str) -> tuple[str, str, int, str]:
    """Question, note and version in the comment at the head of an SQL file, and the statement below it.

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
    return header[0], " ".join(header[2:]), int(version[1]), "\n".join(lines).strip().removesuffix(";")


def _parse(name: str, text: str) -> Macro:
    """The macro in one file."""
    question, note, version, statement = read_header(f"macros/{name}.sql", text)
    match = _MACRO.fullmatch(statement)
    if match is None or match["name"] != name:
        raise ValueError(f"macros/{name}.sql: must be one statement: CREATE MACRO {name}(...) AS ...")
    parameters = tuple(part.strip() for part in match["parameters"].split(",") if part.strip())
    return Macro(name, question, note, version, parameters, match["table"] is not None, match["body"])


_MACRO = re.compile(r"CREATE MACRO (?P<name>\w+)\((?P<parameters>[^()]*)\) AS (?P<table>TABLE\s+)?(?P<body>.+)", re.DOTALL)
