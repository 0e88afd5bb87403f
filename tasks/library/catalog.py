"""What is said of a library's models beside them: the folder's own index and license, and catalogs, told apart by what they hold."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file, stays_in
from schemas.parsing import json_value
from schemas.text import one_line
from tasks.library.formats import DRAWN_ON, FORMATS, INDEX, LICENSES
from tasks.library.licenses import UNKNOWN, License, license_of
from tasks.library.metadata import GZIP, Facts, ModelFacts, abo_facts, objaverse_facts, plain_facts
from tasks.unpacking import gunzip


@dataclasses.dataclass(frozen=True)
class Catalog:
    """Facts by model, as of `tasks.library.metadata`. license: Of models whose facts name none. notes: What could not be used, a line
    each."""

    facts: Mapping[str, ModelFacts]
    license: License = UNKNOWN
    notes: tuple[str, ...] = ()

    def of(self, file: str) -> ModelFacts:
        """What is known of a file, by its path relative to the library, else by its name without ending."""
        stem = file.rpartition("/")[2].rpartition(".")[0]
        facts = self.facts.get(file) or self.facts.get(stem) or ModelFacts()
        return facts if facts.license != UNKNOWN else dataclasses.replace(facts, license=self.license)


def catalog_of(folder: Path, metadata: Sequence[Path] = ()) -> Catalog:
    """The catalog of a folder: its own `index.json` and license, and what further files say, which comes before that.

    metadata: Lists of the kind of `index.json`, Objaverse's annotations and LVIS categories, ABO's `3dmodels.csv` and listings; packed by
    gzip or not. Of two that name a model the later one counts.

    Raises:
        InputError: a further file is none of these, or broken; the folder's own are left out with a note.
    """
    own, notes = _own_index(folder)
    license_, license_notes = _own_license(folder)
    facts: Facts = {**own, **_stated([(path.name, _read(path)) for path in metadata], license_)}
    return Catalog(facts, license_of(license_), (*notes, *license_notes))


def library_files(folder: Path) -> list[Path]:
    """Files whose content decides what a library holds, sorted: models and what they may draw on, the index and the license.

    Links that lead out of the folder are left out, and pipes and devices.

    Raises:
        InputError: there is no such folder.
    """
    if not folder.is_dir():
        raise InputError(folder, "library", "is no folder", "name the folder that holds the library's models")
    endings = (*DRAWN_ON, *(ending for kind in FORMATS for ending in kind.endings))
    own = {folder / name for name in (INDEX, *LICENSES)}
    files = []
    for place, _, names in os.walk(folder):
        paths = [Path(place, name) for name in names if name.lower().endswith(endings) or Path(place, name) in own]
        files += [path for path in paths if path.is_file() and stays_in(path, folder)]
    return sorted(files)


def _own_index(folder: Path) -> tuple[Facts, list[str]]:
    """Facts of `index.json`, and why it is not used."""
    path = folder / INDEX
    if not os.path.lexists(path):
        return {}, []
    try:
        _check_inside(path, folder)
        return plain_facts(read_file(path, path.name, BUDGET.text_bytes)), []
    except (InputError, OSError) as error:
        return {}, [f"{INDEX} is not used, categories come from file names: {_plain(one_line(error))[:200]}"]


def _own_license(folder: Path) -> tuple[str, list[str]]:
    """First line of the first license file that has one, '' without one, and why one is not used."""
    notes = []
    for path in (folder / name for name in LICENSES if os.path.lexists(folder / name)):
        try:
            _check_inside(path, folder)
            lines = read_file(path, path.name, BUDGET.text_bytes).decode(errors="replace").splitlines()
        except (InputError, OSError) as error:
            notes.append(f"{path.name} is not used: {_plain(one_line(error))[:200]}")
            continue
        stated = next((line.strip() for line in lines if line.strip()), "")
        if stated:
            return stated, notes
    return "", notes


def _check_inside(path: Path, folder: Path) -> None:
    if not stays_in(path, folder):
        raise InputError(path.name, "file", "is a link that leads out of the library", "copy it in")


def _stated(files: Sequence[tuple[str, bytes]], license_: str) -> Facts:
    """Facts of further files, by what each holds."""
    annotations, listings, facts = [], [], {}
    table, lvis = b"", None
    for name, data in files:
        kind = _kind(name, data)
        if kind == "plain":
            facts.update(plain_facts(data, name))
        elif kind == "annotations":
            annotations.append((name, data))
        elif kind == "lvis":
            lvis = data
        elif kind == "table":
            table = data
        else:
            listings.append(data)
    if lvis is not None and not annotations:
        raise InputError("--metadata", "lvis", "names categories of uids, and no annotations say more", "name a file of annotations, too")
    if listings and not table:
        raise InputError("--metadata", "listings", "come without `3dmodels.csv`", "name that file, too")
    for name, data in annotations:
        facts.update(objaverse_facts(data, lvis, name))
    if table:
        facts.update(abo_facts(listings, table, license_))
    return facts


def _kind(name: str, data: bytes) -> str:
    """What a file of metadata is: `plain`, `annotations`, `lvis`, `table` or `listings`.

    Raises:
        InputError: none of these.
    """
    if name.lower().removesuffix(".gz").endswith(".csv"):
        return "table"
    try:
        text = gunzip(data) if data[:2] == GZIP else data
        content = _document(text)
    except Exception as error:  # cut, broken, or no JSON, in whatever way
        raise InputError(name, "content", f"is no JSON ({one_line(error)})"[:300], "is it the right file?") from error
    values = list(content.values()) if isinstance(content, dict) else content if isinstance(content, list) else []
    first = values[0] if values else None
    if isinstance(content, dict) and ("3dmodel_id" in content or "item_id" in content):
        return "listings"
    if isinstance(content, dict) and isinstance(first, list):
        return "lvis"
    if isinstance(first, dict) and (isinstance(content, dict) or "uid" in first):
        return "annotations"
    if isinstance(content, list):
        return "plain"
    raise InputError(
        name, "content", "is no index, and none of Objaverse's or ABO's files", "name one with `file` and `category` of every model"
    )


def _document(text: bytes) -> Any:
    """The JSON of a file; of one with a document on every line the first."""
    first, _, rest = text.partition(b"\n")
    if rest.strip() and len(first) > 2:
        try:
            line = json_value(first)
        except ValueError:
            return json_value(text)
        if isinstance(line, dict):
            return line
    return json_value(text)


def _read(path: Path) -> bytes:
    return read_file(path, path.name, BUDGET.unpacked_bytes)


def _plain(text: str) -> str:
    return text.encode("utf-8", "replace").decode()
