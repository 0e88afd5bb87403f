"""The benchmark of scans without labels: single frames; held against goals."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.capture.frames import frames_report
from bench.machine import machine

FRAMES = "frames"

PARTS = (FRAMES,)
"""What can be measured: instances of single frames of tables."""


@dataclasses.dataclass(frozen=True)
class CaptureBench:
    """What is measured. frames: Generated ones. realdata: Folder with the real frames that drawings are of; None for none. parts: Of
    `PARTS`."""

    frames: int = 30
    seed: int = 0
    realdata: Path | None = None
    parts: tuple[str, ...] = PARTS

    @property
    def advances(self) -> int:
        """How often the benchmark advances."""
        return len(self.parts)


def run_capture_bench(config: CaptureBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report. `advance` is told each part of it that is done.

    Raises:
        InputError: a real frame that a drawing is of is not where it should be.
    """
    parts: dict[str, Any] = {}
    if FRAMES in config.parts:
        parts[FRAMES] = frames_report(config.frames, config.seed, config.realdata)
        advance(FRAMES)
    return {"machine": machine(), "seed": config.seed, "parts": parts, "goals": [row for part in parts.values() for row in part["goals"]]}
