"""What a target of fuzzing is: a door at which files of others come in."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from tests.fuzzing.cases import Case

PARSER, STAGE = 10_000, 1_000
"""Inputs of a parser, and of what runs a whole stage or the parser of others."""


class Refused(Exception):
    """An input was refused as it should be, by what is no reader of ours: click, or pydantic in Prefect's hands."""


@dataclasses.dataclass(frozen=True)
class Target:
    """A door. count: inputs of a full run. seeds: sound inputs. read: what is called with the folder of a case.

    within: The same without another process, where `read` starts one.
    """

    name: str
    count: int
    seeds: Callable[[], list[Case]]
    read: Callable[[Path], object]
    within: Callable[[Path], object] | None = None
