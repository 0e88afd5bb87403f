"""Exports out of the lake into a folder: files of scenes by hard copy of blobs, files of datasets assembled over scenes."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from flows.outputs.shipment import Shipment, attribution_page, remake_scenes, shipment
from flows.progress import Progress
from schemas.capture import Scene
from schemas.errors import InputError
from schemas.exports import ExportCheck, ExportFile
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.lineage.licenses import OF_THE_SCAN
from schemas.machine.scratch import temporary_folder
from schemas.wording import meant
from tasks.capture.products import EXPORT_MARK
from warehouse.lake import Lake
from warehouse.release import snapshot_of
from warehouse.release.licenses import Allowed
from warehouse.tables.snapshot import Reader

if TYPE_CHECKING:
    from tasks.exports.format import ExportFormat


@dataclasses.dataclass(frozen=True)
class Chosen:
    """The rows of a snapshot to export, and in which formats.

    `missing` says what of all that could be meant is not there: scenes without an export, or without one in a format that
    others have, a line each. `absent` are formats of which the lake has nothing at all.
    """

    rows: tuple[ExportFile, ...]
    formats: tuple[str, ...]
    missing: tuple[str, ...]
    absent: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class WrittenExports:
    """What was written: how many files, the root file and the package of every USD scene, and checks that did not pass.

    `shipment` says what was left out because of its license; None when all licenses were allowed. `missing` is what the
    lake has not; `removed` are older exports that were taken away because it has nothing in their place; `emptied` are
    formats of which nothing may be shipped.
    """

    files: int
    usd_scenes: tuple[Path, ...]
    findings: tuple[str, ...]
    usd_packages: tuple[Path, ...] = ()
    shipment: Shipment | None = None
    missing: tuple[str, ...] = ()
    removed: tuple[Path, ...] = ()
    emptied: tuple[str, ...] = ()

    @property
    def failed_checks(self) -> int:
        """Rules that are broken by the folder as written."""
        return len(self.findings)

    @property
    def problems(self) -> tuple[str, ...]:
        """Why this is not the export that was asked for, a line each; empty where it is."""
        return (*self.findings, *(f"{name}: the allowed licenses leave nothing of it" for name in self.emptied))

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be known of it, a line each."""
        return (*self.missing, *(f"{place}: an older export was removed: the lake has none in this format" for place in self.removed))


def chosen_exports(lake: Lake, reader: Reader, formats: Sequence[str] = (), scenes: Sequence[str] = ()) -> Chosen:
    """What of a snapshot is meant by formats and scenes. No format means all that the lake has, no scene the same.

    Raises:
        InputError: there is nothing of a format or a scene that is named, or nothing at all.
    """
    known = [row.scene_id for row in reader.rows(Scene)]
    everything = list(reader.rows(ExportFile))
    rows = [row for row in everything if not scenes or row.scene_id in scenes]
    has: dict[str, set[str]] = {}
    for row in rows:
        has.setdefault(row.scene_id, set()).add(row.format)
    there = {name for names in has.values() for name in names}
    wanted = tuple(dict.fromkeys(formats)) or tuple(name for name in EXPORT_FORMATS if name in there)
    for scene in sorted(set(scenes)):
        lacks = [name for name in formats if name not in has.get(scene, ())] if has.get(scene) else [""]
        if lacks:
            what = f"no {lacks[0]} export".replace("  ", " ")
            only = f"it has {', '.join(sorted(has[scene]))}; " if has.get(scene) else ""
            near = "" if scene in known else meant(scene, known)
            raise InputError(lake.address, "export_files", f"{what} of {scene}", f"{near}{only}see `metascenes scenes`")
    for name in wanted:
        if name not in there:
            only = f"it has {', '.join(sorted(there))}; " if there else ""
            remedy = f"{only}`exports.formats` says what a run makes"
            raise InputError(lake.address, "export_files", f"the lake has no {name} export", remedy)
    if not rows:
        raise InputError(lake.address, "export_files", "the lake has no exports", "see `metascenes status`")
    held = {row.format for row in everything}
    expected = wanted if formats else tuple(name for name in EXPORT_FORMATS if name in held)
    missing = []
    for scene in sorted(set(scenes) or {*known, *has}):
        lacks = [name for name in expected if name not in has.get(scene, ())]
        if lacks:
            missing.append(f"{scene}: no {', '.join(lacks) if has.get(scene) else ''} export".replace("  ", " "))
    absent = () if formats else tuple(name for name in EXPORT_FORMATS if name not in held)
    missing += [f"{name}: the lake has no export in this format" for name in absent]
    return Chosen(tuple(row for row in rows if row.format in wanted), wanted, tuple(missing), absent)


def write_exports(
    lake: Lake,
    out: Path,
    formats: Sequence[str] = (),
    scenes: Sequence[str] = (),
    snapshot_id: int | None = None,
    *,
    release: str | None = None,
    usdz: bool = False,
    allowed: Allowed | None = None,
    workers: int = 1,
) -> WrittenExports:
    """Write `<out>/usd`, `<out>/habitat` and so on, each replaced as a whole, and check what was written.

    Without formats all are written that the lake has; of the others, what an older export left goes: it must not pass for
    one of this lake. Scenes whose checks in the lake did not pass are written all the same; the findings name them. Files
    are the lake's blobs, byte for byte; only of a release every `scene.usda` says which one it is from, and scenes whose
    files name the license of a scan `LicenseRef-scan`, as older versions did, are made again. With `usdz`, `<out>/usd` has
    a package of every scene beside its folder: tools edit the folder, and hand on the package. It is made here, since the
    lake would keep every byte of it twice.

    With `allowed`, scenes and objects whose licenses are not among these are left out: scenes without some of their
    objects are made again, by `workers` processes. Every format's folder then says in `LEFT_OUT.md` what is missing and in
    `ATTRIBUTION.md` whom to name.

    Raises:
        InputError: a scene or format that is named is not in the lake, or nothing is; there is no such release, packages
            are asked for without USD, or `<out>/<format>` holds what no export wrote.
    """
    from tasks.exports.formats import FORMATS
    from tasks.exports.layout import layout, shared_files
    from tasks.families import member

    snapshot_id = snapshot_of(lake, release, snapshot_id)
    reader = lake.snapshot(snapshot_id)
    chosen = chosen_exports(lake, reader, formats, scenes)
    written = [member(FORMATS, name) for name in chosen.formats]
    packed = [format_ for format_ in FORMATS if format_.package is not None]
    if usdz and not any(format_ in written for format_ in packed):
        titles, names = " or ".join(format_.title for format_ in packed), " or ".join(format_.name for format_ in packed)
        raise InputError("--usdz", "format", f"asks for packages of {titles}, which are not exported", f"add --format {names}")
    for name in (*chosen.formats, *chosen.absent):
        _check_ours(out / name)
    with _shipped(lake, reader, chosen, allowed, workers) as goods:
        placed = layout(goods.rows)
        shared = shared_files(goods.rows, goods.blobs)
        for format_ in written:
            _write_format(out, format_.name, placed, shared, goods, partial(_finish, format_, release, snapshot_id, usdz))
    removed = tuple(out / name for name in chosen.absent if (out / name / MARK).is_file())
    for place in removed:
        shutil.rmtree(place)
    present = [format_ for format_ in written if any(row.format == format_.name for row in goods.rows)]  # of the others nothing is left
    opened = [(format_, path) for format_ in present for path in format_.opened(out / format_.name) if path.exists()]
    usd = tuple(path for format_, path in opened if format_ in packed and path.suffix != format_.suffix)
    packages = tuple(path for format_, path in opened if format_ in packed and path.suffix == format_.suffix)
    findings = [f"{path}: {finding}" for format_, path in opened for finding in format_.check(path) if finding.is_error]
    findings += goods.incomplete
    emptied = tuple(format_.name for format_ in written if format_ not in present)
    files = len(placed) + len(shared) + len(packages)
    return WrittenExports(files, usd, tuple(findings), packages, goods.shipment, chosen.missing, removed, emptied)


@dataclasses.dataclass(frozen=True)
class _Goods:
    """What is written: rows, their blobs, what was left out, the pages that say so, and scenes that lack something."""

    rows: list[ExportFile]
    blobs: Mapping[str, bytes]
    shipment: Shipment | None
    pages: dict[str, str]
    incomplete: list[str]


@contextlib.contextmanager
def _shipped(lake: Lake, reader: Reader, chosen: Chosen, allowed: Allowed | None, workers: int) -> Iterator[_Goods]:
    """What of the chosen rows may be shipped, as it is or made again."""
    rows, pages, sent = list(chosen.rows), {}, None
    again: dict[str, frozenset[str] | None] = dict.fromkeys(_unresolved(lake, reader, rows))
    if allowed is not None:
        sent = shipment(reader, sorted({row.scene_id for row in rows}), allowed)
        rows = [row for row in rows if row.scene_id in sent.scenes]
        again = {scene: None for scene in again if scene in sent.scenes} | dict(sent.kept)
        pages = {"LEFT_OUT.md": sent.page(allowed), "ATTRIBUTION.md": attribution_page(reader, sent)}
    whole = {row.scene_id for row in rows} - again.keys()
    rows = [row for row in rows if row.scene_id in whole]
    lacking = [row for row in reader.rows(ExportCheck) if row.scene_id in whole]
    if not again:
        yield _Goods(rows, lake.blobs, sent, pages, _incomplete(lacking, chosen.formats))
        return
    with temporary_folder() as place, Progress("scenes made again", len(again)) as progress:
        made, checks = remake_scenes(lake, reader, again, chosen.formats, place, workers, progress.advance)
        blobs = _Blobs(place, lake.blobs)
        yield _Goods([*rows, *made], blobs, sent, pages, _incomplete([*lacking, *checks], chosen.formats))


def _unresolved(lake: Lake, reader: Reader, rows: Sequence[ExportFile]) -> list[str]:
    """Scenes whose files say no more of an asset's license than that it is the scan's."""
    with reader.connect(names=frozenset()) as connection:
        cut = "SELECT DISTINCT scene_id FROM placements JOIN assets USING (asset_id) WHERE contains(assets.license, ?)"
        scenes = {scene for (scene,) in connection.execute(cut, [OF_THE_SCAN]).fetchall()}
    files = [row for row in rows if row.scene_id in scenes and row.role == "scene"]
    return sorted({row.scene_id for row in files if OF_THE_SCAN.encode() in lake.blobs[row.file_blob]})


def _incomplete(checks: Sequence[ExportCheck], formats: Sequence[str]) -> list[str]:
    """Scenes that lack objects, a line each: no file that is there says so."""
    incomplete = [row for row in checks if row.rule == "complete" and row.format in formats and not row.passed]
    return [
        f"{row.scene_id}: {row.format}: {row.rule}: {row.message}" for row in sorted(incomplete, key=lambda row: (row.scene_id, row.format))
    ]


class _Blobs(Mapping[str, bytes]):
    """Blobs of a lake, and files in a folder that are named in the same way."""

    def __init__(self, folder: Path, blobs: Mapping[str, bytes]) -> None:
        self._folder, self._blobs = folder, blobs

    def __getitem__(self, name: str) -> bytes:
        file = self._folder / name
        return file.read_bytes() if file.is_file() else self._blobs[name]

    def __iter__(self) -> Iterator[str]:
        return iter({*(file.name for file in self._folder.iterdir()), *self._blobs})

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _write_format(
    out: Path, name: str, placed: Mapping[str, str], shared: Mapping[str, bytes], goods: _Goods, finish: Callable[[Path], None]
) -> None:
    """Write one format's folder anew and put it in its place."""
    making = out / f".{name}.making"
    shutil.rmtree(making, ignore_errors=True)
    for path, blob in placed.items():
        if path.startswith(f"{name}/"):
            _copy(goods.blobs, blob, making / path.removeprefix(f"{name}/"))
    for path, data in shared.items():
        if path.startswith(f"{name}/"):
            target = making / path.removeprefix(f"{name}/")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
    if making.exists():
        finish(making)
    for page, text in goods.pages.items():  # also where nothing is left: an older export must not pass for this one
        making.mkdir(parents=True, exist_ok=True)
        (making / page).write_text(text, encoding="utf-8")
    if making.exists():
        (making / MARK).write_text("Written by `metascenes export`; replaced as a whole by the next one.\n")
        _replace(making, out / name)


def _finish(format_: ExportFormat, release: str | None, snapshot_id: int | None, packs: bool, making: Path) -> None:
    """What is said and packed only when scenes leave the lake."""
    for scene in format_.opened(making):
        if format_.with_release is not None and release is not None and snapshot_id is not None:
            scene.write_bytes(format_.with_release(scene.read_bytes(), snapshot_id, release))
        if format_.package is not None and packs:
            files = {path.relative_to(scene.parent).as_posix(): path.read_bytes() for path in scene.parent.rglob("*") if path.is_file()}
            try:
                packed = format_.package(files, scene.name)
            except ValueError as error:
                raise InputError(scene.parent.name, format_.suffix.lstrip("."), str(error), "export it without --usdz") from error
            (making / f"{scene.parent.name}{format_.suffix}").write_bytes(packed)


MARK = EXPORT_MARK
"""In the root of a written export: the folder is ours to replace."""


def _check_ours(place: Path) -> None:
    """Refuse to replace what no export wrote."""
    if place.exists() and not (place.is_dir() and ((place / MARK).is_file() or not any(place.iterdir()))):
        raise InputError(str(place), "folder", "holds files that no export wrote", "give another --out")


def _replace(making: Path, place: Path) -> None:
    """Put a finished folder where an older export, or nothing, was."""
    old = place.with_name(f".{place.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if place.exists():
        os.replace(place, old)
    os.replace(making, place)
    shutil.rmtree(old, ignore_errors=True)


def _copy(blobs: Mapping[str, bytes], blob: str, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(blobs[blob])
