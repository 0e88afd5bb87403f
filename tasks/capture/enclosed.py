"""Recorded scans in folders of another one, by the names in them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path

from schemas.errors import InputError
from tasks.capture.layout import is_frame_name, leads_up
from tasks.capture.likeness import MATERIALS, visible
from tasks.capture.products import product_of
from tasks.capture.scan import ScanFormat

MAX_DEPTH_BELOW = 4
"""Folders below a scan or below the search in which scans and meshes are still named."""


def enclosed_scans(
    folder: Path, formats: Sequence[ScanFormat], admits: Callable[[Path], bool], is_passed: Callable[[Path], bool] = lambda place: False
) -> list[str]:
    """Recorded scans below a folder: their paths from it, and the formats that they have. Nothing below them is named.

    admits: False for links that are not followed. is_passed: True for folders that are left out with all that lies in them.
    """
    found: list[str] = []
    level = scan_folders(folder, admits)
    for _ in range(MAX_DEPTH_BELOW):
        inner: list[Path] = []
        for place in level:
            if is_passed(place):
                continue
            if name := recorded_format(place, formats):
                found.append(f"{place.relative_to(folder).as_posix()} ({name})")
            else:
                inner += scan_folders(place, admits)
        level = inner
    return found


def scan_folders(folder: Path, admits: Callable[[Path], bool]) -> list[Path]:
    """Folders in a folder that may be scans: neither products of this project, nor images alone."""
    places = []
    with contextlib.suppress(OSError):  # the search says so
        for path in visible(folder):
            if path.is_dir() and admits(path) and not leads_up(path) and _may_be_scan(path) and not product_of(path):
                places.append(path)
    return places


def recorded_format(folder: Path, formats: Sequence[ScanFormat]) -> str:
    """Name of the format whose recorded scan a folder is, or that has scans in it; '' for none."""
    for format in (format for format in formats if not format.suffixes):
        try:
            if format.recognize(folder) is not None or (format.within is not None and format.within(folder)):
                return format.name
        except InputError:  # it looks like one
            return format.name
        except OSError:
            return ""
    return ""


def _may_be_scan(folder: Path) -> bool:
    """True unless a folder holds images and texts alone that are not frames: asking each format about thousands takes long."""
    return any(path.suffix.lower() not in MATERIALS or is_frame_name(path.name) for path in folder.iterdir())
