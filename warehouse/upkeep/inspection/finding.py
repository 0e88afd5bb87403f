"""A finding: one fault of a lake, or merely left over in it."""

from __future__ import annotations

import dataclasses

from schemas import text
from warehouse.tables.delta import LogError


@dataclasses.dataclass(frozen=True)
class Fault:
    """What is wrong: where (a path relative to the lake), in which field, and what to do.

    An error says that something is lost or wrong; a warning that something lies there which nobody needs.
    """

    kind: str
    file: str
    field: str
    problem: str
    remedy: str
    is_error: bool = True

    def __str__(self) -> str:
        head = ": ".join(part for part in (self.file, self.field, self.problem) if part)
        return f"{head}; {self.remedy}" if self.remedy else head


def in_short(error: BaseException) -> str:
    """An error of a library in a few words."""
    return text.one_line(error.reason if isinstance(error, LogError) else error)[:200]
