"""Scans of several floors as a scan of each: which are to be divided, what was divided already, and their folders, whole or not at all."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from flows.run.fingerprints import FileHashes, canonical_json, code_fingerprint, digest
from flows.run.identity import content_of
from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.parsing import json_value
from tasks.capture.formats import survey
from tasks.capture.layout import STOREYS_RECORD
from tasks.capture.scan import Scan

if TYPE_CHECKING:
    from tasks.capture.scenes import CaptureConfig
    from tasks.capture.storeys.splitting import Divided


@dataclasses.dataclass(frozen=True)
class ScanStoreys:
    """What became of a scan. action: `divided`, `unchanged` (it was before), `whole` (it has one storey) or `failed`. floors: Heights of
    its floors above the lowest [m]. folders: Of the storeys' scans, below the folder that was named."""

    scene_id: str
    scan: str
    action: Literal["divided", "unchanged", "whole", "failed"]
    floors: tuple[float, ...] = ()
    folders: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    error: str | None = None


def divide_scans(
    scans: Iterable[Scan], out: Path, config: CaptureConfig, dry_run: bool = False, advance: Callable[[str], None] = lambda _: None
) -> list[ScanStoreys]:
    """Write a scan of each storey of those scans that have several, below a folder for each in `out`; the others stay where they are.

    The folder of a scan appears whole or not at all. What was divided from the same files by the same code and settings stays. One bad
    scan stops none of the others. `advance` is told each scan that is done.
    """
    hashes, done = FileHashes(), []
    for scan in scans:
        try:
            done.append(_divide(scan, out, config, hashes, dry_run))
        except InputError as error:
            done.append(ScanStoreys(scan.scene_id, str(scan.path), "failed", error=str(error)))
        except OSError as error:
            problem = InputError(scan.path.name, "files", str(error), "check that they can be read, and --out written")
            done.append(ScanStoreys(scan.scene_id, str(scan.path), "failed", error=str(problem)))
        except Exception as error:  # a defect of ours, of which a line says what and where, as in a run
            from flows.worker import kind_and_text

            done.append(ScanStoreys(scan.scene_id, str(scan.path), "failed", error=kind_and_text(error)[1]))
        advance(scan.scene_id)
    hashes.save()
    return done


def _divide(scan: Scan, out: Path, config: CaptureConfig, hashes: FileHashes, dry_run: bool) -> ScanStoreys:
    from tasks.capture.storeys.splitting import divided

    folder = out / scan.scan
    if not dry_run:
        _mend(folder)
    known = _record(folder)
    if known is not None and known["scene_id"] != scan.scene_id:
        raise InputError(folder, "folder", f"has the storeys of {known['scene_id']}", "name another --out, or remove it")
    code = code_fingerprint("tasks.capture.storeys.splitting")
    mark = digest(content_of(scan, survey(scan)[0], hashes).named, scan.format, canonical_json(config), code)
    if known is not None and known.get("mark") == mark:
        return _outcome(scan, "unchanged", known)
    if known is None and folder.exists():
        raise InputError(folder, "folder", "is there already, and is none of storeys", "name another --out, or remove it")
    parted = divided(scan, config)
    if not parted.storeys:
        if known is not None and not dry_run:
            _remove(folder)
        return ScanStoreys(scan.scene_id, str(scan.path), "whole", notes=parted.notes)
    record = _facts(parted, mark)
    if not dry_run:
        _write(folder, parted, record)
    return _outcome(scan, "divided", record, parted.notes)


def _outcome(scan: Scan, action: Literal["divided", "unchanged"], record: dict[str, Any], notes: tuple[str, ...] = ()) -> ScanStoreys:
    folders = tuple(f"{scan.scan}/{storey['scan']}" for storey in record["storeys"])
    floors = tuple(storey["floor_m"] for storey in record["storeys"])
    return ScanStoreys(scan.scene_id, str(scan.path), action, floors, folders, notes)


def _record(folder: Path) -> dict[str, Any] | None:
    """What a folder of storeys says of itself; None where it is none.

    Raises:
        InputError: what it says cannot be read.
    """
    path = folder / STOREYS_RECORD
    if not path.is_file():
        return None
    name = f"{folder.name}/{STOREYS_RECORD}"
    try:
        record = json_value(read_file(path, name, BUDGET.settings_bytes))
        _ = record["scene_id"], [(str(storey["scan"]), float(storey["floor_m"])) for storey in record["storeys"]]
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise InputError(name, "content", "is not a record of storeys", "remove the folder") from error
    return dict(record)


def _facts(scan: Divided, mark: str) -> dict[str, Any]:
    """What is recorded; matrices row by row. to_original: Brings a storey's scan, as it is read (+Z up) [m], to the coordinates of the file
    that it was divided from. to_level: Brings it to its own floor at z = 0 [m], with the same axes for all."""
    lowest = scan.levels.floors[0]
    storeys = [
        {
            "scan": scan.name(storey),
            "floor_m": round(storey.floor - lowest, 6),
            "frames": len(storey.reading.frames),
            "to_original": scan.to_original.ravel().tolist(),
            "to_level": scan.to_level(storey).ravel().tolist(),
        }
        for storey in scan.storeys
    ]
    cuts = [round(cut - lowest, 6) for cut in scan.levels.cuts]
    return {"scene_id": scan.scan.scene_id, "format": scan.scan.format, "cuts_m": cuts, "storeys": storeys, "mark": mark}


def _remove(folder: Path) -> None:
    """Take away the storeys of a scan that has one now."""
    going = _beside(folder, "making")  # as what is half there, which nobody puts back
    os.replace(folder, going)
    shutil.rmtree(going)


def _mend(folder: Path) -> None:
    """Leave nothing of what was stopped: the former storeys are back where no others took their place, and else gone."""
    making, former = _beside(folder, "making"), _beside(folder, "former")
    if former.exists() and not folder.exists():
        os.replace(former, folder)
    for left in (making, former):
        shutil.rmtree(left, ignore_errors=True)


def _beside(folder: Path, word: str) -> Path:
    """A hidden folder beside that of a scan's storeys, in which nobody looks for scans."""
    return folder.with_name(f".{folder.name}.{word}")


def _write(folder: Path, scan: Divided, record: dict[str, Any]) -> None:
    """Put the folder of a scan's storeys in its place, or in that of a former one."""
    from tasks.capture.storeys.splitting import write_divided

    making = _beside(folder, "making")
    making.mkdir(parents=True)
    try:
        write_divided(making, scan)
        (making / STOREYS_RECORD).write_text(json.dumps(record, indent=1) + "\n")
        if folder.exists():
            os.replace(folder, _beside(folder, "former"))
        os.replace(making, folder)
    finally:
        _mend(folder)
