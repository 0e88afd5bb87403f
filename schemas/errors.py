"""Errors meant for people: one line that names the file and the field and says what to do."""

from __future__ import annotations

from pathlib import PurePath

from schemas.text import concealed, one_line


class LakeError(Exception):
    """Anything the project refuses on purpose. Its text is one line, fit for a terminal, a log and a row of the lake: no
    credentials of an address, and no characters that would command the terminal."""

    def __init__(self, *parts: object) -> None:
        super().__init__(*(one_line(part) if isinstance(part, str) else part for part in parts))


class InputError(LakeError):
    """Input that cannot be used: names the file, the field, what is wrong and what to do.

    ``InputError("scene0001_00.txt", "axisAlignment", "determinant is 0", "remove the line to have it estimated")``
    prints ``scene0001_00.txt: axisAlignment: determinant is 0; remove the line to have it estimated``.
    """

    def __init__(self, file: str | PurePath, field: str, problem: str, remedy: str = "") -> None:
        self.file, self.field, self.problem, self.remedy = map(one_line, (file, field, problem, remedy))
        super().__init__(self.file, self.field, self.problem, self.remedy)

    def __str__(self) -> str:
        head = ": ".join(part for part in (self.file, self.field, self.problem) if part)
        return f"{head}; {self.remedy}" if self.remedy else head


def check_address(address: object, field: str = "") -> None:
    """Refuse an address with credentials in it: it would be written down in settings, in logs and on servers.

    Raises:
        InputError: says so, without them.
    """
    text = str(address)
    is_path = ":" not in text.partition("/")[0]  # folders may be named `signature=v1`
    scheme, _, rest = text.partition("://")
    user, at, host = rest.partition("/")[0].rpartition("@")
    if at and user:
        text = f"{scheme}://...@{host}"  # whatever letters its credentials have
    if (at and user) or (not is_path and concealed(text) != text):
        raise InputError(
            text, field, "the address carries credentials", "give them by the environment: AWS_ACCESS_KEY_ID, AWS_PROFILE, ..."
        )


class RecordError(LakeError):
    """A row that breaks its schema: names table, row, field and rule."""

    def __init__(self, table: str, row: str, field: str, rule: str) -> None:
        self.table, self.row, self.field, self.rule = map(one_line, (table, row, field, rule))
        super().__init__(self.table, self.row, self.field, self.rule)

    def __str__(self) -> str:
        return f"{self.table}: row {self.row}: {self.field}: {self.rule}"
