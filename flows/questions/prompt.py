"""Statements, one after the other: typed at a terminal until somebody leaves, or read from standard input until the first error."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Literal

from flows.questions.bounds import Bounds, write_bounded
from flows.questions.names import COMMANDS, SqlNames
from flows.questions.statements import in_one_line, is_blank, parted
from schemas.budget import BUDGET
from schemas.errors import InputError, LakeError
from schemas.text import one_line
from schemas.wording import meant

if TYPE_CHECKING:
    from warehouse.questions.answers import Output
    from warehouse.questions.attached import Attached
    from warehouse.tables.snapshot import Reader

PROMPT, MORE = "lake> ", " ...> "
"""What stands before the first line of a statement, and before the others."""


class SqlPrompt:
    """Statements on one snapshot. form, most: How answers are written, and how many rows; 0 shows all."""

    def __init__(self, reader: Reader, form: Output, most: int, bounds: Bounds, attached: Sequence[Attached] = ()) -> None:
        self._reader, self._most, self._bounds, self._attached = reader, most, bounds, attached
        self._form = self._usual = form
        self._names = SqlNames(reader, attached)
        self._begun = ""  # lines of a statement that is not ended yet

    def typed(self) -> None:
        """Ask for lines at a terminal until `\\q` or Ctrl-D. Ctrl-C drops the line, or ends the question; errors are one line each."""
        from flows.questions.editor import edited

        which = f"release {name}" if (name := self._release()) else f"snapshot {self._reader.snapshot_id}"
        print(rf"{which}; statements end with a semicolon, \? says what else there is, \q leaves", file=sys.stderr)
        with edited(lambda before, word: self._names.completions(self._begun + before, word)) as keep:
            while True:
                try:
                    line = input(MORE if self._begun else PROMPT)
                except EOFError:
                    print()
                    return
                except KeyboardInterrupt:
                    print()
                    self._begun = ""
                    continue
                try:
                    for statement in self._ended(line):
                        keep(statement if statement.startswith("\\") else f"{in_one_line(statement)};")
                        if self._carry_out(statement) == "left":
                            return
                except LakeError as error:
                    print(one_line(error), file=sys.stderr)
                except KeyboardInterrupt:
                    print("interrupted", file=sys.stderr)

    def read(self, lines: Iterable[str]) -> None:
        """Carry out the statements of a text. The last one need not be ended.

        Raises:
            LakeError: one of them is refused; those behind it are not asked. Or there is none.
        """
        is_any = False
        for line in lines:
            for statement in self._ended(line.removesuffix("\n")):
                is_any = True
                if self._carry_out(statement) == "left":
                    return
        if not is_blank(self._begun):
            self._carry_out(self._begun)
        elif not is_any:
            raise InputError("SQL", "", "there is no statement", 'write one. Example: metascenes sql "SELECT * FROM scenes"')

    def _release(self) -> str | None:
        names = [row.name for row in self._reader.releases if row.snapshot_id == self._reader.snapshot_id]
        return names[0] if names else None

    def _ended(self, line: str) -> list[str]:
        """What a line ends: a command of ours, or statements; the rest of it begins the next one."""
        if not self._begun and line.lstrip().startswith("\\"):
            return [line.strip()]
        statements, self._begun = parted(f"{self._begun}{line}\n")
        if is_blank(self._begun):
            self._begun = ""
        if len(self._begun) > BUDGET.statement_bytes:
            self._begun = ""
            raise InputError("SQL", "", f"the statement has more than {BUDGET.statement_bytes} characters", "end it with a semicolon")
        return statements

    def _carry_out(self, statement: str) -> Literal["left"] | None:
        if not statement.startswith("\\"):
            from flows.terminal import output

            sys.stdout.flush()
            write_bounded(output(), self._reader, statement, self._form, self._most, self._bounds, self._attached)
            return None
        word, _, name = statement.rstrip("; ").partition(" ")
        match word:
            case "\\q":
                return "left"
            case "\\x":
                self._form = self._usual if self._form == "expanded" else "expanded"
                print(f"answers are written as {self._form}", file=sys.stderr)
            case "\\d":
                _print_columns(self._described(name.strip()) if name.strip() else self._listed())
            case "\\?":
                _print_columns(list(COMMANDS.items()))
            case _:
                raise InputError("SQL", word, "there is no such command", rf"{meant(word, COMMANDS)}\? lists them")
        return None

    def _listed(self) -> list[tuple[str, ...]]:
        return [(entry.kind, entry.signature, entry.text) for entry in self._names.listed]

    def _described(self, name: str) -> list[tuple[str, ...]]:
        """Columns of a table or view, or what a macro is."""
        bare = name.strip('"').lower()
        if bare in self._names.columns:
            return list(self._names.columns[bare])
        for entry in self._names.listed:
            if entry.name == bare:
                return [(entry.kind, entry.signature, entry.text)]
        known = [entry.name for entry in self._names.listed]
        raise InputError("SQL", name, "there is no such table, view or macro", rf"{meant(bare, known)}\d lists them")


def _print_columns(rows: Sequence[tuple[str, ...]]) -> None:
    """Rows of texts in columns."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    for row in rows:
        print("  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[-1]]).rstrip())
