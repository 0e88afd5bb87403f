"""Materials of an OBJ as exporters write them: colors, images found by name, and the rest of a material library left out."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import is_there, read_file
from tasks.capture.files.named import Folders
from tasks.capture.files.obj import material_name
from tasks.capture.files.ply import texture_files

COLOR_MAPS = ("map_kd", "map_ka")
"""Keywords of images that give a surface its color, the first that is there is taken."""

IMAGES = (".png", ".jpg", ".jpeg")
"""Endings of the image of an OBJ whose material library is missing; it has the name of the OBJ."""

_MAP = re.compile(r"map_\w+|bump|disp|decal|norm|refl")

_NUMBERS = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2}
"""Options of an image that take up to so many numbers; all others take one word."""

_WORDS = frozenset({"-blendu", "-blendv", "-boost", "-bm", "-cc", "-clamp", "-imfchan", "-texres", "-type", "-colorspace"})

_BOMS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


@dataclasses.dataclass(frozen=True)
class MapLine:
    """An image that a material names.

    names: Readings of the file's name, the likeliest first. scale, offset: Applied to texture coordinates (u, v).
    """

    names: tuple[str, ...]
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class ObjMaterial:
    """A material. color: display values, 0 to 1. image: file of its image. scale, offset: of texture coordinates (u, v)."""

    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    image: Path | None = None
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class Materials:
    """The material libraries of an OBJ.

    looks: materials by name, blanks in names taken as one. files: all files that the libraries draw on, with themselves.
    outside: names that lead out of the dataset's folder. notes: losses, a line each.
    """

    looks: dict[str, ObjMaterial]
    files: tuple[Path, ...]
    outside: tuple[str, ...]
    notes: tuple[str, ...]


def decoded(data: bytes) -> bytes:
    """Text of an OBJ or MTL as UTF-8 without a byte order mark; other bytes as they are."""
    for mark, encoding in _BOMS:
        if data.startswith(mark):
            return data.decode(encoding, "replace").encode("utf-8", "replace")
    return data


def read_materials(data: bytes, path: Path, root: Path) -> Materials:
    """Materials that the OBJ at `path`, with the decoded text `data`, draws on; files outside `root` are not opened."""
    folders = Folders(root)
    outside: list[str] = []
    notes: list[str] = []
    files: list[Path] = []
    looks: dict[str, ObjMaterial] = {}
    libraries = _libraries(data, path.parent, folders, outside, notes)
    if not libraries and notes and not outside:
        alone = [file for ending in IMAGES if (file := folders.find((path.stem + ending,), path.parent, path.parent)) is not None]
        if len(alone) == 1:
            notes.append(f"{alone[0].name} is taken for its image, by its name")
            files = alone
            used = re.finditer(rb"(?im)^[ \t]*usemtl\b([^\r\n]*)", data)
            looks = {material_name(match[1].split()): ObjMaterial(image=alone[0]) for match in used}
    see_through: list[str] = []
    for library in libraries:
        files.append(library)
        for name, statements in _blocks(decoded(read_file(library, library.name, BUDGET.text_bytes))):
            color = _color(statements.get("kd", ""))
            see_through += [name] if _is_see_through(statements) else []
            shown: tuple[MapLine, Path] | None = None
            for keyword in sorted(filter(_MAP.fullmatch, statements), key=_rank):
                line = map_line(statements[keyword])
                file = folders.find(line.names, library.parent, path.parent)
                if file is not None:
                    files.append(file)
                    shown = shown or ((line, file) if keyword in COLOR_MAPS else None)
                elif keyword in COLOR_MAPS:
                    notes.append(f"{line.names[0]} is missing, drawn without it")
            if shown is not None and color == (0.0, 0.0, 0.0):
                notes.append(f"material {name} is black under its image: the image is taken as it is")
                color = None
            looks[name] = ObjMaterial(color or (1.0, 1.0, 1.0))
            if shown is not None:
                looks[name] = dataclasses.replace(looks[name], image=shown[1], scale=shown[0].scale, offset=shown[0].offset)
    if see_through:
        notes.append(f"materials that let light through are read as solid: {', '.join(see_through)}"[:200])
    return Materials(looks, tuple(dict.fromkeys(files)), tuple(outside), tuple(dict.fromkeys(notes)))


def map_line(rest: str) -> MapLine:
    """The words behind an image's keyword: options in front of or behind a name that may have blanks and quotes."""
    rest = rest.strip()
    words = rest.split()
    numbers: dict[str, list[float]] = {}
    first = _skip_options(words, numbers)
    name = " ".join(words[first:]) if first else rest
    # Some exporters write options behind the name.
    last = next((i for i, word in enumerate(words[first + 1 :], first + 1) if word.lower() in {*_NUMBERS, *_WORDS}), len(words))
    _skip_options(words[last:], numbers)
    names = [name, " ".join(words[first:last]), rest]
    if not first and last == len(words):
        names = [rest]

    def pair(option: str, default: float) -> tuple[float, float]:
        values = numbers.get(option, [])
        u = values[0] if values else default
        return u, (values[1] if len(values) > 1 else default)

    return MapLine(tuple(dict.fromkeys(filter(None, names))) or ("",), pair("-s", 1.0), pair("-o", 0.0))


def _skip_options(words: Sequence[str], numbers: dict[str, list[float]]) -> int:
    """Number of leading words that are options; their numbers are kept in `numbers`."""
    at = 0
    while at < len(words) and words[at].lower() in {*_NUMBERS, *_WORDS}:
        option = words[at].lower()
        at += 1
        if option in _WORDS:
            at += 1
            continue
        values: list[float] = []
        while at < len(words) and len(values) < _NUMBERS[option] and (value := _number(words[at])) is not None:
            values.append(value)
            at += 1
        numbers[option] = values
    return min(at, len(words))


def _number(word: str) -> float | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return value if math.isfinite(value) and abs(value) < 1e6 else None


def _color(rest: str) -> tuple[float, float, float] | None:
    """Color of a `Kd` line, 0 to 1; one number is gray; None for none."""
    values = [value for word in rest.split()[:3] if (value := _number(word)) is not None]
    if len(values) not in (1, 3):
        return None
    red, green, blue = (min(max(value, 0.0), 1.0) for value in (values if len(values) == 3 else values * 3))
    return red, green, blue


def _is_see_through(statements: Mapping[str, str]) -> bool:
    """True if a material states an opacity (`d`) below one, a transparency (`Tr`) above none, or an image of either."""
    opacity, transparency = (_last_number(statements.get(keyword, "")) for keyword in ("d", "tr"))
    # Exporters write `Tr 1` and `d 1` of one solid material.
    is_open = opacity is not None and opacity < 1.0
    return "map_d" in statements or is_open or (opacity is None and transparency is not None and 0.0 < transparency < 1.0)


def _last_number(rest: str) -> float | None:
    words = rest.split()
    return _number(words[-1]) if words else None


def _rank(keyword: str) -> int:
    return COLOR_MAPS.index(keyword) if keyword in COLOR_MAPS else len(COLOR_MAPS)


def _blocks(data: bytes) -> Iterator[tuple[str, dict[str, str]]]:
    """Materials of a library: name, and the words behind each keyword in lower case, the last of several."""
    name: str | None = None
    statements: dict[str, str] = {}
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").decode("utf-8", "surrogateescape").splitlines():
        words = line.strip().split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        rest = words[1].strip() if len(words) > 1 else ""
        if words[0].lower() == "newmtl":
            if name is not None:
                yield name, statements
            name, statements = " ".join(rest.split()), {}
        elif rest:
            keyword = words[0].lower()
            # Names of images may hold a `#`, which starts a comment behind numbers.
            statements[keyword] = rest if _MAP.fullmatch(keyword) else rest.partition("#")[0].strip()
    if name is not None:
        yield name, statements


def _libraries(data: bytes, folder: Path, folders: Folders, outside: list[str], notes: list[str]) -> list[Path]:
    """Material libraries that an OBJ names, each once, in their order."""
    libraries: list[Path] = []
    for match in re.finditer(rb"(?im)^[ \t]*mtllib[ \t]+([^\r\n]+)", data):
        line = match[1].decode("utf-8", "surrogateescape").strip()
        whole = folders.find((line,), folder, folder)
        # A line may name several libraries, and a name may have blanks.
        quoted = re.findall(r'"([^"]+)"', line)
        named = [line] if whole is not None else quoted or [f"{part}.mtl" for part in re.split(r"(?i)\.mtl(?=\s|$)", line) if part.strip()]
        if whole is None and not line.lower().endswith(".mtl"):
            named = [line, *line.split()]
        files = [(name.strip(), folders.find((name.strip(),), folder, folder)) for name in named]
        if not any(file for _, file in files):
            if folders.leads_out(named[0].strip(), folder):
                outside.append(named[0].strip())
            notes.append(f"{line} is missing, drawn without it")
        else:
            notes += [f"{name} is missing, drawn without it" for name, file in files if file is None and name != line]
        libraries += [file for _, file in files if file is not None]
    return list(dict.fromkeys(libraries))


def material_files(path: Path, root: Path) -> list[Path]:
    """Files that an OBJ's materials or a PLY name, sorted, those that exist inside `root`; empty for other kinds."""
    if path.suffix.lower() == ".ply" and is_there(path):
        return texture_files(path, root)
    if path.suffix.lower() != ".obj" or not is_there(path):
        return []
    try:
        return sorted(read_materials(decoded(read_file(path, path.name, BUDGET.model_bytes)), path, root).files)
    except (InputError, ValueError):
        return []
