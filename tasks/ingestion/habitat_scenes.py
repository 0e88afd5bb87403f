"""The scenes of a Habitat scene dataset: which there are, and which files and settings each of them comes from."""

from __future__ import annotations

import csv
import glob
import io
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from schemas.errors import InputError
from schemas.files import is_there, stays_in
from tasks.capture.files.documents import first_line, name_of, read_text
from tasks.exports.findings import Finding
from tasks.exports.habitat import shapes
from tasks.exports.habitat.library import ENDINGS, Library, Template, read_json, read_library
from tasks.ingestion.materials import material_files
from tasks.ingestion.scene import Source
from tasks.ingestion.values import LICENSES

_IDS = ("id", "handle", "object_id", "template_name", "name")
_CATEGORIES = ("clean_category", "main_category", "category", "super_category", "type")
"""Columns of the category tables in use (HSSD's `object_categories_filtered.csv` and `fpmodels-with-decomposed.csv`)."""


def habitat_scenes(root: Path, dataset: str) -> list[Source]:
    """Every scene of the dataset in `root`, sorted by scene id; a scene that cannot be read says why.

    Raises:
        InputError: the folder has no scene dataset config, or several, or one that cannot be read.
    """
    library = read_library(root)
    if not library.config:
        raise InputError(root.name, "*.scene_dataset_config.json", "there is none", "name the folder of a Habitat scene dataset")
    broken = [
        finding
        for finding in library.findings
        if finding.rule in ("json", "shape", "dataset_config") and finding.where.split()[0] == library.config
    ]
    broken += [finding for finding in library.findings if finding.where == "."]
    if broken:
        where = library.config if broken[0].where == "." else broken[0].where
        raise InputError(where, broken[0].rule, broken[0].message, "`metascenes doctor habitat` lists all that is wrong")
    facts = _Facts(library, _lexicons(library), _categories(root), _license(root))
    sources = [facts.source(template, dataset) for template in library.sections["scene_instances"].values()]
    for finding in library.findings:  # a scene file that could not be read is in no section
        if finding.where.endswith(ENDINGS["scene_instances"]):
            name = PurePosixPath(finding.where).name.removesuffix(ENDINGS["scene_instances"])
            files = tuple(path for path in (root / finding.where,) if path.is_file())
            error = InputError(finding.where, finding.rule, finding.message, "export it again")
            sources.append(Source("habitat", root, dataset, name, files, {}, error))
    if not sources:
        raise InputError(library.config, "scene_instances", "the dataset lists no scene", "name a dataset with scenes")
    return sorted(sources, key=lambda source: source.scene_id)


class _Facts:
    """What all scenes of a dataset share."""

    def __init__(self, library: Library, lexicon: Mapping[int, str], categories: Mapping[str, str], license: str | None) -> None:
        self._library, self._lexicon, self._categories, self._license = library, lexicon, categories, license

    def source(self, scene: Template, dataset: str) -> Source:
        """A scene with all that it names."""
        root = self._library.root
        files = {root / scene.file}
        notes: list[str] = []
        about: dict[str, Any] = {"file": scene.file, "scene": dict(scene.values), "license": self._license, "notes": notes}
        problem = None
        try:
            about["stage"] = self._stage(scene, files, notes)
            about["templates"] = self._templates(scene, files, notes)
            about["navmesh"] = self._navmesh(scene, files, notes)
        except InputError as error:
            problem = error
        count = scene.values.get("articulated_object_instances")
        if isinstance(count, list) and count:
            notes.append(f"{scene.file}: {len(count)} articulated objects are left out")
        for path in sorted(root.glob(f"*/*/content/{glob.escape(scene.handle)}.json.gz")):
            notes.append(f"{path.relative_to(root).as_posix()}: episodes are not read")
        inside = sorted(file for file in files if is_there(file) and stays_in(file, root))
        return Source("habitat", root, dataset, scene.handle, tuple(inside), about, problem)

    def _stage(self, scene: Template, files: set[Path], notes: list[str]) -> dict[str, Any] | None:
        named = scene.values.get("stage_instance", {}).get("template_name")
        if named is None:
            raise InputError(scene.file, "stage_instance", "is missing", "every Habitat scene has a stage")
        template = self._template("stages", named, f"{scene.file}", "stage_instance.template_name", notes)
        return self._described(template, files)

    def _templates(self, scene: Template, files: set[Path], notes: list[str]) -> dict[str, dict[str, Any]]:
        templates: dict[str, dict[str, Any]] = {}
        for index, placed in enumerate(scene.values.get("object_instances", [])):
            field = f"object_instances[{index}].template_name"
            name = placed.get("template_name")
            if name is None:
                raise InputError(scene.file, field, "is missing", "name an object of the dataset")
            if name not in templates:
                template = self._template("objects", name, scene.file, field, notes)
                facts = self._described(template, files)
                number = template.values.get("semantic_id")
                facts["class_name"] = self._lexicon.get(number, "") if isinstance(number, int) else ""
                facts["category"] = self._categories.get(template.handle) or self._categories.get(PurePosixPath(facts["render"]).stem, "")
                templates[name] = facts
        return templates

    def _described(self, template: Template, files: set[Path]) -> dict[str, Any]:
        """A template as JSON values: what it says, and where its meshes are, from the dataset's folder."""
        root = self._library.root
        facts: dict[str, Any] = {"handle": template.handle, "file": template.file, "values": dict(template.values)}
        files.add(root / template.file)
        for key, name in (("render_asset", "render"), ("collision_asset", "collision")):
            asset = template.values.get(key, "")
            facts[name] = ""
            if not asset or not PurePosixPath(asset).suffix:  # none, or a primitive that habitat-sim makes itself
                continue
            path = template.folder / asset
            if not stays_in(path, root):
                raise InputError(template.file, key, f"{asset!r} leaves the dataset's folder", "copy it in")
            if key == "render_asset" and not is_there(path):
                raise InputError(template.file, key, f"{asset!r} does not exist", "copy the dataset again")
            if is_there(path):
                facts[name] = path.resolve().relative_to(root).as_posix()
                files |= {path.resolve(), *material_files(path.resolve(), root)}
        return facts

    def _navmesh(self, scene: Template, files: set[Path], notes: list[str]) -> str:
        handle = scene.values.get("navmesh_instance", "")
        path = self._library.navmeshes.get(handle, "")
        if handle and not path:
            notes.append(f"{scene.file}: navmesh_instance: {handle!r} is no navmesh of the dataset")
        elif path and not is_there(self._library.root / path):
            notes.append(f"{scene.file}: navmesh_instance: {path} does not exist")
            path = ""
        if path:
            files.add((self._library.root / path).resolve())
        return path

    def _template(self, section: str, name: str, file: str, field: str, notes: list[str]) -> Template:
        """The template that habitat-sim would take: of that name, else the first whose name contains it."""
        known = self._library.sections[section]
        plain = PurePosixPath(name).name.removesuffix(ENDINGS[section]).removesuffix(".glb")
        for handle in (name, plain):
            if handle in known:
                return known[handle]
        partial = [handle for handle in sorted(known) if plain and plain.lower() in handle.lower()]
        if partial:
            note = f"{file}: {field}: there is no {name!r}; {partial[0]!r} taken, whose name contains it, as habitat-sim does"
            notes.append(note)
            return known[partial[0]]
        why = next(
            (finding for finding in self._library.findings if plain and PurePosixPath(finding.where.split()[0]).name.startswith(plain)),
            None,
        )
        reason = f" ({_text(why)})" if why else ""
        raise InputError(file, field, f"{name!r} is none of the dataset's {section}{reason}", "copy the dataset again")


def _text(finding: Finding) -> str:
    return f"{finding.where}: {finding.message}"


def _lexicons(library: Library) -> dict[int, str]:
    """Names of semantic classes by number, of all lexicons that can be read."""
    lexicon: dict[int, str] = {}
    for path in library.semantics.values():
        if path.endswith(".json") and not path.endswith(".semantic_config.json"):
            document = read_json(library.root / path, library.root, [], shapes.LEXICON)
            for item in (document or {}).get("classes", []):
                lexicon.setdefault(item["id"], item["name"])
    return lexicon


def _categories(root: Path) -> dict[str, str]:
    """Categories by the name of an object, from the tables in `metadata` and `semantics` that have an id and a category."""
    categories: dict[str, str] = {}
    for path in sorted(file for folder in ("metadata", "semantics") for file in (root / folder).glob("*.csv")):
        if not stays_in(path, root):
            continue
        try:
            rows = list(csv.DictReader(io.StringIO(read_text(path, name_of(path, root)))))
        except csv.Error:
            continue  # no table of categories; what it says is not needed to read the scenes
        columns: Sequence[str] = list(rows[0]) if rows else ()
        key = next((name for name in _IDS if name in columns), None)
        value = next((name for name in _CATEGORIES if name in columns), None)
        if key and value:
            for row in rows:
                if row[key] and row[value]:
                    categories.setdefault(row[key], row[value])
    return categories


def _license(root: Path) -> str | None:
    """First line of the dataset's licence file, None without one."""
    for name in LICENSES:
        if (root / name).is_file():
            return first_line(root / name, root)
    return None
