"""What the process does that reads a USD file: keep to its limits, look at what the file draws on, then compose and flatten it."""

from __future__ import annotations

import dataclasses
import io
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import check_file, is_there, read_file, stays_in
from tasks.confinement import answer, limit
from tasks.library.confinement import MODEL

LAYERS = (".usd", ".usda", ".usdc")
PICTURES = (".png", ".jpg", ".jpeg")

MOST_LAYERS = 256
"""Files that one model is composed of."""


def main() -> None:
    """Read or list the file that the arguments name, and leave the answer in the folder that they name."""
    task, path, root, folder = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), Path(sys.argv[4])
    limit(int(sys.argv[5]), int(sys.argv[6]))
    answer(folder, lambda: _read(task, path, root, folder), "export it again")


def _read(task: str, path: Path, root: Path, folder: Path) -> dict[str, Any]:
    """The files that a USD file draws on, for the task `list`; otherwise facts on its model, which is left in the folder."""
    if path.suffix.lower() == ".usdz":
        root = folder / "package"
        path = unpacked(path, root)
    files, notes = drawn_on(path, root)
    if task == "list":
        return {"files": [str(file) for file in files]}
    from tasks.composition import refuse_large_stage
    from tasks.geometry.meshes import dump_glb
    from tasks.library.usd.stage import Flattened

    refuse_large_stage(path)
    flat = Flattened(path, root, rooms=task == "room")
    (folder / MODEL).write_bytes(dump_glb(flat.parts()))
    facts: dict[str, Any] = {"unit_m": flat.unit_m, "up": flat.up, "notes": [*notes, *flat.notes]}
    if flat.elements:
        facts["elements"] = [dataclasses.astuple(element) for element in flat.elements]
        facts["part_elements"] = flat.part_elements
    return facts


def unpacked(path: Path, folder: Path) -> Path:
    """The first layer of a package, whose files are put below `folder`.

    Raises:
        InputError: it is no package by the standard: compressed, larger than it says, or with names that lead out of it.
    """
    data = read_file(path, path.name, BUDGET.asset_bytes)
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
    except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        raise InputError(path.name, "package", f"is no zip archive ({error})", "export it again") from error
    entries = [entry for entry in archive.infolist() if not entry.is_dir()]
    if len(entries) > MOST_LAYERS or sum(entry.file_size for entry in entries) > len(data):
        problem = f"holds {len(entries)} files of {sum(entry.file_size for entry in entries)} bytes in {len(data)}"
        raise InputError(path.name, "package", problem, "a usdz holds its files as they are: make it with usdzip")
    for entry in entries:
        name = PurePosixPath(entry.filename)
        if name.is_absolute() or ".." in name.parts or "\\" in entry.filename or "\0" in entry.filename:
            raise InputError(path.name, "package", f"holds {entry.filename[:80]!r}, which lies outside of it", "make it with usdzip")
        if entry.compress_type != zipfile.ZIP_STORED or entry.flag_bits & 1:
            raise InputError(path.name, "package", f"{entry.filename[:80]!r} is compressed or encrypted", "make it with usdzip")
        if name.suffix.lower() not in (*LAYERS, *PICTURES):
            continue
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(archive.read(entry))
    if not entries or PurePosixPath(entries[0].filename).suffix.lower() not in LAYERS:
        raise InputError(path.name, "package", "its first file is no layer", "make it with usdzip")
    return folder / entries[0].filename


def drawn_on(path: Path, root: Path) -> tuple[list[Path], list[str]]:
    """Layers and pictures that a layer draws on, itself not among them, and a line for each that is missing.

    Layers are opened one by one, and nothing is composed: what leads out of `root` is refused before it is opened.

    Raises:
        InputError: a layer is broken, or names something outside of the folder, at another address, or made up of variables.
    """
    from pxr import Sdf

    layers, pictures, notes, waiting, held = {path.resolve()}, set[Path](), [], [path], 0
    while waiting:
        file = waiting.pop()
        check_file(file, file.name, BUDGET.asset_bytes)
        held += file.stat().st_size
        if held > BUDGET.asset_bytes or len(layers) > MOST_LAYERS:
            raise InputError(path.name, "layers", f"are more than {MOST_LAYERS}, or {BUDGET.asset_bytes} bytes", "flatten it")
        layer = Sdf.Layer.FindOrOpen(str(file))
        if layer is None:
            raise InputError(path.name, "layer", f"{file.name} is no layer of USD", "export it again")
        named = [(name, LAYERS) for name in layer.GetCompositionAssetDependencies() if name]
        named += [(name, PICTURES) for name in _assets(layer)]
        for name, kinds in named:
            target = _target(name, file, root, path.name)
            if target.suffix.lower() not in kinds:
                if kinds is LAYERS:
                    raise InputError(path.name, "reference", f"{name[:80]!r} is no layer", "flatten it into one file")
                continue
            if not is_there(target):
                notes.append(f"{name[:80]} is missing")
            elif kinds is PICTURES:
                pictures.add(target)
            elif target.resolve() not in layers:
                layers.add(target.resolve())
                waiting.append(target)
    return sorted({*layers, *pictures} - {path.resolve()}), sorted(set(notes))


def _target(name: str, layer: Path, root: Path, file: str) -> Path:
    """Where an asset path of a layer leads.

    Raises:
        InputError: out of the folder, or elsewhere than to a file.
    """
    if "://" in name or ":SDF_FORMAT_ARGS:" in name or any(sign in name for sign in "`[]\0"):
        raise InputError(file, "reference", f"{name[:80]!r} is no plain path", "flatten it into one file")
    target = layer.parent / name
    if not stays_in(target, root):
        raise InputError(file, "reference", f"{name[:80]!r} leads out of the folder", "copy what it names in, or flatten it")
    return target


def _assets(layer: Any) -> Iterator[str]:
    """Asset paths that are values of a layer's attributes.

    Raises:
        InputError: prims draw on clips, which are not read.
    """
    from pxr import Sdf

    names: list[str] = []
    clipped: list[str] = []

    def look(path: Any) -> None:
        spec = layer.GetObjectAtPath(path)
        if spec is None:
            return
        if path.IsPrimPath() and spec.HasInfo("clips"):
            clipped.append(str(path))
        if path.IsPropertyPath() and isinstance(spec, Sdf.AttributeSpec) and spec.typeName in (Sdf.ValueTypeNames.Asset,):
            value = spec.default
            if isinstance(value, Sdf.AssetPath) and value.path:
                names.append(value.path)

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    if clipped:
        raise InputError(layer.GetDisplayName(), "clips", f"{clipped[0]} draws on value clips", "flatten it into one file")
    yield from names
