"""Exports out of the lake into a folder: files of scenes by hard copy of blobs, files of datasets assembled over scenes."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from flows.progress import Progress
from flows.shipment import Shipment, attribution_page, remake_scenes, shipment
from schemas.errors import InputError
from schemas.exports import FORMATS, ExportFile
from tasks.exports.findings import Finding
from warehouse.lake import Lake
from warehouse.licenses import Allowed
from warehouse.release import snapshot_of
from warehouse.snapshot import Reader


@dataclasses.dataclass(frozen=True)
class WrittenExports:
    """What was written: how many files, the root file and the package of every USD scene, and checks that did not pass.

    `shipment` says what was left out because of its license; None when all licenses were allowed.
    """

    files: int
    usd_scenes: tuple[Path, ...]
    findings: tuple[str, ...]
    usd_packages: tuple[Path, ...] = ()
    shipment: Shipment | None = None

    @property
    def failed_checks(self) -> int:
        """Rules that are broken by the folder as written."""
        return len(self.findings)


def write_exports(
    lake: Lake,
    out: Path,
    formats: Sequence[str] = FORMATS,
    scenes: Sequence[str] = (),
    snapshot_id: int | None = None,
    *,
    release: str | None = None,
    usdz: bool = False,
    allowed: Allowed | None = None,
    workers: int = 1,
) -> WrittenExports:
    """Write `<out>/usd`, `<out>/habitat` and so on, each replaced as a whole, and check what was written.

    Scenes whose checks in the lake did not pass are written all the same; the findings name them. Files are the lake's
    blobs, byte for byte; only of a release every `scene.usda` says which one it is from. With `usdz`, `<out>/usd` has a
    package of every scene beside its folder: tools edit the folder, and hand on the package. It is made here, since the
    lake would keep every byte of it twice.

    With `allowed`, scenes and objects whose licenses are not among these are left out: scenes without some of their
    objects are made again, by `workers` processes. Every format's folder then says in `LEFT_OUT.md` what is missing and in
    `ATTRIBUTION.md` whom to name.

    Raises:
        InputError: a scene is not in the lake or has no export, there is no such release, packages are asked for without
            USD, or `<out>/<format>` holds what no export wrote.
    """
    from tasks.exports.layout import layout, shared_files

    snapshot_id = snapshot_of(lake, release, snapshot_id)
    if usdz and "usd" not in formats:
        raise InputError("--usdz", "format", "asks for packages of USD scenes, which are not exported", "add --format usd")
    reader = lake.snapshot(snapshot_id)
    rows = [row for row in reader.rows(ExportFile) if row.format in formats and (not scenes or row.scene_id in scenes)]
    missing = sorted(set(scenes) - {row.scene_id for row in rows})
    if missing:
        raise InputError(lake.address, "export_files", f"no export of {missing[0]}", "see `metascenes status`")
    for name in formats:
        _check_ours(out / name)
    with _shipped(lake, reader, rows, formats, allowed, workers) as (rows, blobs, sent, pages):
        placed = layout(rows)
        shared = shared_files(rows, blobs)
        for name in formats:
            _write_format(out, name, placed, shared, blobs, pages, lambda making: _finish_usd(making, release, snapshot_id, usdz))
    usd = tuple(
        sorted(out / "usd" / row.path for row in rows if row.format == "usd" and row.role == "scene" and row.path.endswith("scene.usda"))
    )
    packages = tuple(path.parent.with_suffix(".usdz") for path in usd) if usdz else ()
    present = {row.format for row in rows}  # nothing may be left of what was asked for
    findings = tuple(_findings(out, [name for name in formats if name in present], (*usd, *packages)))
    return WrittenExports(len(placed) + len(shared) + len(packages), usd, findings, packages, sent)


@contextlib.contextmanager
def _shipped(
    lake: Lake, reader: Reader, rows: list[ExportFile], formats: Sequence[str], allowed: Allowed | None, workers: int
) -> Iterator[tuple[list[ExportFile], Mapping[str, bytes], Shipment | None, dict[str, str]]]:  # fmt: skip
    """Rows of what may be shipped, their blobs, what was left out, and the pages that say so."""
    if allowed is None:
        yield rows, lake.blobs, None, {}
        return
    sent = shipment(reader, sorted({row.scene_id for row in rows}), allowed)
    whole = set(sent.scenes) - sent.kept.keys()
    pages = {"LEFT_OUT.md": sent.page(allowed), "ATTRIBUTION.md": attribution_page(reader, sent)}
    with tempfile.TemporaryDirectory(prefix="metascenes-") as place, Progress("scenes made again", len(sent.kept)) as progress:
        made = remake_scenes(lake, reader, sent, formats, Path(place), workers, progress.advance)
        yield [*(row for row in rows if row.scene_id in whole), *made], _Blobs(Path(place), lake.blobs), sent, pages


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
    out: Path, name: str, placed: Mapping[str, str], shared: Mapping[str, bytes], blobs: Mapping[str, bytes], pages: Mapping[str, str],
    finish_usd: Callable[[Path], None],
) -> None:  # fmt: skip
    """Write one format's folder anew and put it in its place."""
    making = out / f".{name}.making"
    shutil.rmtree(making, ignore_errors=True)
    for path, blob in placed.items():
        if path.startswith(f"{name}/"):
            _copy(blobs, blob, making / path.removeprefix(f"{name}/"))
    for path, data in shared.items():
        if path.startswith(f"{name}/"):
            target = making / path.removeprefix(f"{name}/")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
    if name == "usd" and making.exists():
        finish_usd(making)
    for page, text in pages.items():  # also where nothing is left: an older export must not pass for this one
        making.mkdir(parents=True, exist_ok=True)
        (making / page).write_text(text, encoding="utf-8")
    if making.exists():
        (making / MARK).write_text("Written by `metascenes export`; replaced as a whole by the next one.\n")
        _replace(making, out / name)


def _finish_usd(making: Path, release: str | None, snapshot_id: int | None, usdz: bool) -> None:
    """What is said and packed only when scenes leave the lake."""
    from tasks.exports.usd import with_release
    from tasks.exports.usd.package import package

    for scene in sorted(making.glob("*/scene.usda")):
        if release is not None and snapshot_id is not None:
            scene.write_bytes(with_release(scene.read_bytes(), snapshot_id, release))
        if usdz:
            files = {path.relative_to(scene.parent).as_posix(): path.read_bytes() for path in scene.parent.rglob("*") if path.is_file()}
            try:
                packed = package(files, scene.name)
            except ValueError as error:
                raise InputError(scene.parent.name, "usdz", str(error), "export it without --usdz") from error
            (making / f"{scene.parent.name}.usdz").write_bytes(packed)


MARK = ".exported"
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


def _findings(out: Path, formats: Sequence[str], usd: Sequence[Path]) -> list[str]:
    """Broken rules of what was written, a line each."""
    from tasks.exports.glb.rules import check_glb
    from tasks.exports.habitat.rules import check_habitat
    from tasks.exports.mjcf.rules import check_mjcf
    from tasks.exports.urdf.rules import check_urdf
    from tasks.exports.usd.rules import check_usd

    gates: dict[str, tuple[Callable[[Path], Sequence[Finding]], Sequence[Path]]] = {
        "usd": (check_usd, usd),
        "habitat": (check_habitat, [out / "habitat"]),
        "mjcf": (check_mjcf, sorted((out / "mjcf").glob("*/scene.xml"))),
        "urdf": (check_urdf, sorted(path.parent for path in (out / "urdf").glob("*/poses.json"))),
        "glb": (check_glb, sorted((out / "glb").glob("*.glb"))),
    }
    found = []
    for name in formats:
        check, paths = gates[name]
        found += [f"{path}: {finding}" for path in paths if path.exists() for finding in check(path) if finding.is_error]
    return found
