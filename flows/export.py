"""Exports out of the lake into a folder: files of scenes by hard copy of blobs, files of datasets assembled over scenes."""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from schemas.errors import InputError
from schemas.exports import FORMATS, ExportFile
from tasks.exports.findings import Finding
from warehouse.lake import Lake
from warehouse.release import snapshot_of


@dataclasses.dataclass(frozen=True)
class WrittenExports:
    """What was written: how many files, the root file and the package of every USD scene, and checks that did not pass."""

    files: int
    usd_scenes: tuple[Path, ...]
    findings: tuple[str, ...]
    usd_packages: tuple[Path, ...] = ()

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
) -> WrittenExports:
    """Write `<out>/usd`, `<out>/habitat` and so on, each replaced as a whole, and check what was written.

    Scenes whose checks in the lake did not pass are written all the same; the findings name them. Files are the lake's
    blobs, byte for byte; only of a release every `scene.usda` says which one it is from. With `usdz`, `<out>/usd` has a
    package of every scene beside its folder: tools edit the folder, and hand on the package. It is made here, since the
    lake would keep every byte of it twice.

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
    placed = layout(rows)
    shared = shared_files(rows, lake.blobs)
    for name in formats:
        making = out / f".{name}.making"
        shutil.rmtree(making, ignore_errors=True)
        for path, blob in placed.items():
            if path.startswith(f"{name}/"):
                _copy(lake, blob, making / path.removeprefix(f"{name}/"))
        for path, data in shared.items():
            if path.startswith(f"{name}/"):
                target = making / path.removeprefix(f"{name}/")
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
        if name == "usd" and making.exists():
            _finish_usd(making, release, snapshot_id, usdz)
        if making.exists():
            (making / MARK).write_text("Written by `metascenes export`; replaced as a whole by the next one.\n")
            _replace(making, out / name)
    usd = tuple(
        sorted(out / "usd" / row.path for row in rows if row.format == "usd" and row.role == "scene" and row.path.endswith("scene.usda"))
    )
    packages = tuple(path.parent.with_suffix(".usdz") for path in usd) if usdz else ()
    findings = tuple(_findings(out, formats, (*usd, *packages)))
    return WrittenExports(len(placed) + len(shared) + len(packages), usd, findings, packages)


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


def _copy(lake: Lake, blob: str, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(lake.blobs[blob])


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
