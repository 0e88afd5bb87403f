"""A scan format: a folder with `toy.txt`, and a ScanNet scan in the folder `data` in it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan, ScanFormat
from tasks.capture.scannet import SCANNET


def within(scan: Scan) -> Scan:
    return dataclasses.replace(scan, format=SCANNET.name, path=scan.path / "data")


def is_toy(folder: Path) -> bool:
    return (folder / "toy.txt").is_file()


def files(scan: Scan, premises: Premises) -> list[Path]:
    return [scan.path / "toy.txt", *SCANNET.files(within(scan), premises)]


def read(scan: Scan) -> Reading:
    return SCANNET.read(within(scan))


TOY_SCAN = ScanFormat(
    name="toy_scan",
    dataset="toys",
    expected="toy.txt and a folder data",
    recognize=lambda folder: folder.name if is_toy(folder) else None,
    is_recorded=is_toy,
    files=files,
    read=read,
    room="(toys/[a-z]+)_[0-9]+",
)
