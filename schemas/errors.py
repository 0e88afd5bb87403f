"""Errors meant for people: one line that names the file and the field and says what to do."""

from __future__ import annotations

from pathlib import PurePath


class LakeError(Exception):
    """Anything the project refuses on purpose. Its text is one line, fit for a terminal."""


class InputError(LakeError):
    """Input that cannot be used: names the file, the field, what is wrong and what to do.

    ``InputError("scene0001_00.txt", "axisAlignment", "determinant is 0", "remove the line to have it estimated")``
    prints ``scene0001_00.txt: axisAlignment: determinant is 0; remove the line to have it estimated``.
    """

    def __init__(self, file: str | PurePath, field: str, problem: str, remedy: str = "") -> None:
        self.file = str(file)
        self.field = field
        self.problem = " ".join(problem.split())
        self.remedy = " ".join(remedy.split())
        super().__init__(self.file, self.field, self.problem, self.remedy)

    def __str__(self) -> str:
        head = ": ".join(part for part in (self.file, self.field, self.problem) if part)
        return f"{head}; {self.remedy}" if self.remedy else head


class RecordError(LakeError):
    """A row that breaks its schema: names table, row, field and rule."""

    def __init__(self, table: str, row: str, field: str, rule: str) -> None:
        self.table, self.row, self.field, self.rule = table, row, field, rule
        super().__init__(table, row, field, rule)

    def __str__(self) -> str:
        return f"{self.table}: row {self.row}: {self.field}: {self.rule}"
