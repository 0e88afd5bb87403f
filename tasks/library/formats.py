"""The formats of a library's files: one function for all of them, and what it gives."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from pathlib import Path

import numpy as np

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file, stays_in
from tasks.library.format import MOST_FACES, ModelFormat, ReadModel
from tasks.library.glb import GLB
from tasks.library.gltf import GLTF
from tasks.library.obj import OBJ
from tasks.library.usd import USD

FORMATS = (GLB, GLTF, OBJ, USD)
"""All kinds of files that a library may hold."""

INDEX = "index.json"
LICENSES = ("LICENSE", "LICENSE.txt", "LICENSE.md")
"""A folder's own files that state facts about its models; the first license that has a line counts."""

DRAWN_ON = (
    ".mtl", ".bin", ".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga", ".tif", ".tiff", ".gif", ".ppm", ".pgm", ".dds", ".jp2", ".exr",
    ".hdr",
)  # fmt: skip
"""Endings of files that models draw on, besides those of models: all under which images are stored."""

FARTHEST = 1e6
"""Coordinates beyond this, in whatever unit, have lost their millimetres."""


def format_of(path: Path) -> ModelFormat | None:
    """The format that a file's name tells; None for what is no model."""
    return next((kind for kind in FORMATS if path.suffix.lower() in kind.endings), None)


def model_files(folder: Path) -> tuple[list[Path], list[str]]:
    """Files below a folder that have names of models, sorted, and a line for each that is not looked at: links that lead out or nowhere,
    pipes, devices. Files that a USD file of the folder draws on are among them, as nobody can tell them from others.

    Raises:
        InputError: there is no such folder.
    """
    if not folder.is_dir():
        raise InputError(folder, "folder", "is no folder", "name the folder that holds the library's models")
    files, unused = [], []
    for place, folders, names in os.walk(folder):
        folders.sort()
        for path in (Path(place, name) for name in sorted(names)):
            if format_of(path) is None:
                continue
            why = "" if stays_in(path, folder) and path.is_file() else _why(path, folder)
            unused += [f"{path.relative_to(folder).as_posix()}: {why}"] if why else []
            files += [] if why else [path]
        for path in (Path(place, name) for name in folders):
            if path.is_symlink():
                unused.append(f"{path.relative_to(folder).as_posix()}: is a link to a folder, which is not followed")
    return sorted(files), sorted(unused)


def skipped_note(folder: Path) -> tuple[str, ...]:
    """Line on the files below a folder that are neither models nor what models draw on, by ending; none without such files."""
    endings: Counter[str] = Counter()
    for place, _, names in os.walk(folder):
        for name in names:
            ending = Path(name).suffix.lower()
            is_own = Path(place) == folder and name in (INDEX, *LICENSES)
            if not is_own and not name.startswith(".") and ending not in DRAWN_ON and format_of(Path(name)) is None:
                endings[ending or "no ending"] += 1
    if not endings:
        return ()
    counts = ", ".join(f"{count} {ending}" for ending, count in sorted(endings.items(), key=lambda each: (-each[1], each[0])))
    readable = ", ".join(ending for kind in FORMATS for ending in kind.endings)
    line = f"skipped files that are not models: {counts}; convert models to one of {readable}"
    return (line.encode("utf-8", "replace").decode(),)


def _why(path: Path, folder: Path) -> str:
    if not path.exists():
        return "is a link that leads nowhere"
    return "is a link that leads out of the library" if not stays_in(path, folder) else "is no regular file"


def read_model(path: Path, root: Path) -> ReadModel:
    """The model in a file below the folder `root`.

    Raises:
        InputError: it is of no known format, broken, larger than the budget, or draws on what lies outside of the folder; says which.
    """
    name = path.relative_to(root).as_posix()
    kind = format_of(path)
    if kind is None:
        endings = ", ".join(ending for each in FORMATS for ending in each.endings)
        raise InputError(name, "format", f"{path.suffix or 'none'} is not read", f"convert it to one of {endings}")
    if not stays_in(path, root):
        raise InputError(name, "file", "lies outside of the library", "copy it in")
    try:
        model = kind.read(path, root)
        check_model(model, name)
    except InputError:
        raise
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, ArithmeticError, MemoryError, OSError) as error:
        raise InputError(name, "content", f"cannot be read ({type(error).__name__}: {error})"[:300], "export it again") from error
    return model


def check_model(model: ReadModel, name: str) -> None:
    """Refuse what is no model of an object, whatever its format.

    Raises:
        InputError: it has no faces, too many of them, names vertices that are not there, or coordinates are not finite or absurd.
    """
    if not model.parts:
        raise InputError(name, "meshes", "holds no triangles", "export it with its geometry")
    faces = sum(len(part.faces) for part in model.parts)
    if faces > MOST_FACES:
        raise InputError(name, "faces", f"are {faces}, more than {MOST_FACES}", "decimate it, or split the scene into its objects")
    for part in model.parts:
        vertices, corners = np.asarray(part.vertices), np.asarray(part.faces)
        if len(corners) and (corners.min() < 0 or corners.max() >= len(vertices)):
            raise InputError(name, "faces", "name vertices that are not there", "export it again")
        if not np.isfinite(vertices).all():
            raise InputError(name, "vertices", "are not finite", "export it again")
        farthest = float(np.abs(vertices).max(initial=0.0))
        if farthest > FARTHEST:
            problem = f"are {farthest:,.0f} units from the origin (limit {FARTHEST:,.0f})"
            raise InputError(name, "vertices", problem, "subtract the survey offset")
    if model.unit_m is not None and not (np.isfinite(model.unit_m) and 1e-6 <= model.unit_m <= 1e6):
        raise InputError(name, "unit", f"is {model.unit_m} m, which nobody measures in", "set metersPerUnit to 0.01 or 1")


def content_of(path: Path, root: Path) -> str:
    """Hash of a file and of all that it draws on below `root`, 64 hex digits: what an entry follows from, wherever it lies.

    Raises:
        InputError: one of them cannot be read, or is larger than the budget.
    """
    kind = format_of(path)
    hashes = hashlib.sha256(f"{path.suffix.lower()}\0".encode())
    for file in [path, *(sorted(kind.beside(path, root)) if kind is not None else [])]:
        data = read_file(file, file.name, BUDGET.asset_bytes)
        name = "" if file == path else os.path.relpath(file, path.parent)
        hashes.update(f"{name}\0{len(data)}\0".encode("utf-8", "surrogateescape") + hashlib.sha256(data).digest())
    return hashes.hexdigest()
