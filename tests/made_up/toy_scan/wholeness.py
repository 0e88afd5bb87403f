"""`toy.txt` ends with a word."""

from __future__ import annotations

from collections.abc import Iterator

from tasks.capture.scan import Scan
from tasks.capture.wholeness import Gap


def gaps(scan: Scan) -> Iterator[Gap]:
    if not (scan.path / "toy.txt").read_text().endswith("the end\n"):
        yield Gap("toy.txt: has no end")
