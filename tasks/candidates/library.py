"""A folder of GLBs as a library: what is in it, and its assets.

Beside the files an `index.json` may lie, a list of `{"file", "category", "licence" or "license", "author", "source",
"repo"}`; what it leaves out comes from the file's name and from a `LICENSE` file.
"""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file, stays_in
from schemas.text import one_line
from tasks.candidates.assets import MAX_EXTENT_M, MIN_EXTENT_M, MadeAsset, charted, make_asset
from tasks.candidates.descriptors import Descriptor, describe
from tasks.candidates.provider import CandidateProvider, NothingToOffer
from tasks.captions.physics import known_name
from tasks.containers import GLB_MAGIC
from tasks.geometry.meshes import load_glb, sample_surface, surface_of
from tasks.settings import Config, Whole
from tasks.unpacking import json_value

if TYPE_CHECKING:
    from tasks.candidates.request import CandidateRequest

SAMPLES = 1500
"""Surface points per file for its descriptor."""

UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "hundreds of metres": 100.0, "kilometres": 1000.0}
"""What files are written in, although GLB is in metres, and how many metres [m] that is."""

ABSURD = 4.0
"""So many times as large or small as is usual for its category, a model is odd: a toy chair is a third of a chair."""

OTHER_UNITS = 15.0
"""So many times as large or small it is in other units: boxes differ by ten."""

PLAUSIBLE = 2.0
"""So near to the usual size a unit has to bring it."""

CACHED_FILES, CACHED_ASSETS = 20_000, 64
"""How many descriptors (6 kB each) and finished assets (megabytes each) a process keeps."""


@dataclasses.dataclass(frozen=True)
class LibraryRetrieval(Config):
    """The k-th best asset of a library folder by category, extents, shape and color."""

    kind: ClassVar[str] = "library"
    k: Whole = 1  # place in the order of scores, 1 is best
    version: str = "2"  # goes up when the same library would answer otherwise


@dataclasses.dataclass(frozen=True)
class LibraryEntry:
    """A file of the library. file: Path relative to the library, forward slashes. scale: metres per unit of the file [m]; the descriptor's
    extents have it."""

    path: Path
    file: str
    category: str
    license: str
    author: str | None
    source: str
    descriptor: Descriptor
    scale: float = 1.0
    source_url: str | None = None


@dataclasses.dataclass(frozen=True)
class LibraryIndex:
    """Every usable file of a library in the order of their names, and one line per file that is not usable or of absurd size."""

    entries: tuple[LibraryEntry, ...]
    problems: tuple[str, ...]


def library_files(folder: Path) -> list[Path]:
    """Files whose content decides what a library holds, sorted: GLBs below `folder`, its index and licence.

    Links that lead out of the folder are left out, and pipes and devices.

    Raises:
        InputError: there is no such folder.
    """
    return [path for path in _named_files(folder) if path.is_file() and not _why(path, folder)]


def _named_files(folder: Path) -> list[Path]:
    """Everything below `folder` that has the name of a library's file, whatever it is, and links to folders; sorted."""
    if not folder.is_dir():
        raise InputError(folder, "library", "is no folder", "name the folder that holds the library's GLB files")
    paths = []
    for place, folders, files in os.walk(folder):
        paths += [Path(place, name) for name in files if name.lower().endswith(".glb")]
        paths += [path for path in (Path(place, name) for name in folders) if path.is_symlink()]
    return sorted([*paths, *(folder / name for name in ("index.json", *_LICENSES) if os.path.lexists(folder / name))])


_LICENSES = ("LICENSE", "LICENSE.txt", "LICENSE.md")


def index_library(folder: Path) -> LibraryIndex:
    """The library in `folder`. Descriptors are kept for as long as the process lives and the file is unchanged.

    Raises:
        InputError: there is no such folder.
    """
    files = library_files(folder)
    unused = [(path.relative_to(folder).as_posix(), why) for path in _named_files(folder) if (why := _why(path, folder))]
    listed, problems = _listed(folder / "index.json") if folder / "index.json" in files else ({}, [])
    license_text = _license([path for path in files if path.name in _LICENSES])
    problems += [f"library: {_plain(file)} left out: {why}" for file, why in unused]
    entries = []
    for path in files:
        if path.suffix.lower() != ".glb":
            continue
        file = path.relative_to(folder).as_posix()
        facts = listed.get(file, {})
        category = _text(facts, "category") or category_of(path.stem)
        try:
            file.encode()  # names are kept in rows
            stat = path.stat()
            descriptor = _descriptor(path, stat.st_size, stat.st_mtime_ns)
            scale, odd = usual_scale(category, descriptor.extents)
            descriptor = dataclasses.replace(descriptor, extents=descriptor.extents * scale)
            _check(descriptor)
        except Exception as error:  # of a file of others, whatever it leads to: it is left out, and the run goes on
            kind = "" if isinstance(error, InputError | ValueError | OSError) else f"{type(error).__name__}: "
            problems.append(f"library: {_plain(file)} left out: {kind}{_reason(error)}")
            continue
        problems += [f"library: {_plain(file)} {odd}"] if odd else []
        entries.append(
            LibraryEntry(
                path=path,
                file=file,
                category=category,
                license=_text(facts, "license") or _text(facts, "licence") or license_text,
                author=_text(facts, "author") or None,
                source=" ".join(part for part in (_text(facts, "repo"), _text(facts, "source")) if part) or file,
                descriptor=descriptor,
                scale=scale,
                source_url=_text(facts, "source_url") or None,
            )
        )
    return LibraryIndex(tuple(entries), tuple(problems))


def library_asset(entry: LibraryEntry) -> MadeAsset:
    """The asset of an entry: the file's parts with their textures, in metres, moved to the canonical origin. Depends on nothing else.

    Raises:
        InputError, ValueError: the file changed since it was indexed and cannot be used any more.
    """
    stat = entry.path.stat()
    facts = (entry.file, entry.category, entry.license, entry.author, entry.source, entry.source_url)
    return _asset(entry.path, stat.st_size, stat.st_mtime_ns, facts, entry.scale)


@lru_cache(maxsize=CACHED_ASSETS)
def _asset(path: Path, size: int, modified_ns: int, facts: tuple[str, str, str, str | None, str, str | None], scale: float) -> MadeAsset:
    file, category, license_text, author, source, source_url = facts
    parts = load_glb(read_file(path, file, BUDGET.asset_bytes, magic=GLB_MAGIC), file)
    if scale != 1.0:
        for part in parts:
            part.apply_scale(scale)
    made = make_asset(
        parts, provider=LibraryRetrieval.kind, name=path.stem, category=category, source=source, license=license_text, author=author,
        source_url=source_url,
    )  # fmt: skip
    return charted(made, parts)


@lru_cache(maxsize=CACHED_FILES)
def _descriptor(path: Path, size: int, modified_ns: int) -> Descriptor:
    """Descriptor of a GLB as its file has it; size and time of change are there for the cache."""
    surface = surface_of(load_glb(read_file(path, path.name, BUDGET.asset_bytes, magic=GLB_MAGIC), path.name))
    extents = np.ptp(surface.bounds, axis=0)
    rng = np.random.default_rng(size)  # a constant of the file: the same descriptor in every run
    points, colors, _ = sample_surface(surface, SAMPLES, rng)
    return describe(points, colors, extents, rng)


def _check(descriptor: Descriptor) -> None:
    """Refuse what is too small or too large for a room, in metres."""
    ordered = np.sort(descriptor.extents)
    if ordered[1] < MIN_EXTENT_M or ordered[2] > MAX_EXTENT_M:
        extents = " x ".join(f"{v:.3g}" for v in descriptor.extents)
        raise ValueError(f"has extents {extents} m, which is no object of a room")


def usual_scale(category: str, extents: ArrayLike) -> tuple[float, str]:
    """Metres per unit of a file that holds a model of a category, of `extents` in its units, shape (3,), and what is odd about its size.

    1 and '' where nothing is, or nobody knows how large such a thing usually is; 1 and a text where no unit explains the size.
    """
    from tasks.furniture import is_known, typical_extents

    name = next((name for name in (category, known_name(category) or "") if is_known(name)), None)
    size = float(np.linalg.norm(np.asarray(extents, dtype=np.float64)))
    if name is None or not np.isfinite(size) or size <= 0.0:
        return 1.0, ""
    ratio = size / float(np.linalg.norm(typical_extents(name)))
    if 1.0 / ABSURD <= ratio <= ABSURD:
        return 1.0, ""
    times = f"{ratio:.3g} times as large as a {name} usually is"
    unit = min(UNITS, key=lambda u: abs(np.log(ratio * UNITS[u])))
    if abs(np.log(ratio)) < np.log(OTHER_UNITS) or abs(np.log(ratio * UNITS[unit])) > np.log(PLAUSIBLE):
        return 1.0, f"is {times}: used as it is"
    return UNITS[unit], f"would be {times}: read as {unit}"


def category_of(stem: str) -> str:
    """Category that a file's name tells: `aws_ChairA_01` is a chair. Words are split at case, digits and signs."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", stem)
    kept = [word.lower() for word in words if len(word) > 1] or [stem.lower()]
    for end in range(len(kept), 0, -1):
        name = known_name(" ".join(kept[:end]))
        if name:
            return name
    return " ".join(kept)


def _listed(path: Path) -> tuple[dict[str, Mapping[str, Any]], list[str]]:
    """Entries of index.json by file, and what is wrong with it."""
    try:
        content = json_value(read_file(path, path.name, BUDGET.text_bytes))
    except (ValueError, InputError) as error:
        return {}, [f"library: index.json not used, categories come from file names: {_reason(error)}"]
    if not isinstance(content, list):
        return {}, ["library: index.json not used, categories come from file names: it is no list"]
    return {str(entry["file"]): entry for entry in content if isinstance(entry, dict) and "file" in entry}, []


def _license(files: Sequence[Path]) -> str:
    """First line of the first of the library's licence files that has one, "unknown" without one."""
    for path in sorted(files, key=lambda path: _LICENSES.index(path.name)):
        try:
            lines = read_file(path, path.name, BUDGET.text_bytes).decode(errors="replace").split("\n")
        except InputError:
            continue
        return next((line.strip()[:120] for line in lines if line.strip()), "unknown")
    return "unknown"


def _why(path: Path, folder: Path) -> str:
    """Why a file that has the name of a library's is not looked at; '' where it is."""
    if not path.exists():
        return "a link that leads nowhere"
    if not stays_in(path, folder):
        return "a link that leads out of the library"
    return "" if path.is_file() or path.is_dir() else "no regular file"


def _text(facts: Mapping[str, Any], name: str) -> str:
    value = facts.get(name)
    return _plain(value.strip()) if isinstance(value, str) else ""


def _plain(text: str) -> str:
    """A text that can be kept: half of a pair of surrogates, and bytes of a name that are none, become question marks."""
    return text.encode("utf-8", "replace").decode()


def _reason(error: Exception) -> str:
    return _plain(one_line(error))[:200]


def _offer(request: CandidateRequest, provider: LibraryRetrieval) -> MadeAsset:
    """The k-th best asset for an instance."""
    best = request.ranking
    if len(best) < provider.k:
        raise NothingToOffer(f"only {len(best)} of the library's assets come near enough")
    return library_asset(best[provider.k - 1][1])


LIBRARY = CandidateProvider(name="library", config=LibraryRetrieval, offer=_offer, needs_library=True)
