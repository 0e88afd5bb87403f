"""Kinds of rooms of the benchmark: hard dwellings, and wild rooms that fail as real scans do."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from tasks.furniture.dwellings import Dwelling, dwelling
from tasks.furniture.wild import foreign_files, wild_room
from tasks.scanner.dwellings import WILD, HardScanSettings, scan_dwelling
from tasks.scanner.truth import DwellingTruth

Kind = Literal["hard", "wild"]

ROOMS: Mapping[Kind, int] = {"hard": 30, "wild": 20}
"""Rooms that are measured unless a number is given."""

SETTINGS: Mapping[Kind, tuple[str, ...]] = {"hard": (), "wild": ("candidates.withheld=true",)}
"""Settings of the stages that a kind always has: wild rooms are furnished with templates that candidates then leave out."""

MODELS = Path("assets")
"""Folder of models by others, below that of real data."""


def home_of(kind: Kind, seed: int, index: int, realdata: Path | None = None) -> Dwelling:
    """Room `index` of a seed. realdata: folder of real data, whose models furnish wild rooms, too, where it has them."""
    if kind == "hard":
        return dwelling((seed, index))
    has_models = realdata is not None and (realdata / MODELS).is_dir()
    return wild_room((seed, index), foreign_files(realdata / MODELS) if realdata is not None and has_models else ())


def has_frames(index: int) -> bool:
    """True if room `index` is scanned with its frames: every other one."""
    return index % 2 == 0


def make_scan(folder: Path, index: int, seed: int, kind: Kind = "hard", realdata: Path | None = None) -> DwellingTruth:
    """Room `index` of a seed as a scan below a folder. The same arguments write the same bytes."""
    settings = dataclasses.replace(HardScanSettings() if kind == "hard" else WILD, frames="exported" if has_frames(index) else "none")
    home = home_of(kind, seed, index, realdata)
    return scan_dwelling(home, folder, f"scene{index:04d}_00", settings, np.random.default_rng([seed, index, 1]))
