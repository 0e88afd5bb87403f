"""The scenes of a Habitat scene dataset: which there are, and which files and settings each of them comes from."""

from __future__ import annotations

import csv
import glob
import io
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from schemas.errors import InputError
from schemas.files import is_there, stays_in
from schemas.wording import counted
from tasks.capture.files.documents import first_line, name_of, read_text
from tasks.exports.findings import Finding
from tasks.exports.habitat import shapes
from tasks.exports.habitat.library import CONFIG_ENDING, ENDINGS, Library, Template, read_library, read_parts
from tasks.ingestion.materials import material_files
from tasks.ingestion.scene import Source
from tasks.ingestion.values import LICENSES

_IDS = ("id", "handle", "object_id", "template_name", "name")
_CATEGORIES = ("clean_category", "main_category", "category", "super_category", "type")
"""Columns of the category tables in use (HSSD's `object_categories_filtered.csv` and `fpmodels-with-decomposed.csv`)."""

MAX_LISTED_CONFIGS = 20
"""Configs that an error lists: a line of a terminal stays readable."""


def dataset_config(path: Path, name: str | None = None) -> Path:
    """The scene dataset config of a dataset.

    Args:
        path: config file, folder of the dataset, or a folder above exactly one config.
        name: file name or path of the config below the folder, with or without its ending; default: the only one.

    Raises:
        InputError: there is no such config, or several; lists them.
    """
    if path.is_file():
        if path.name.endswith(CONFIG_ENDING) and name is None:
            return path
        field, problem = ("--config", "is not needed") if name is not None else ("file name", f"does not end in {CONFIG_ENDING}")
        raise InputError(path.name, field, problem, "name a scene dataset config or its folder")
    levels = [sorted(path.glob(f"{above}*{CONFIG_ENDING}")) for above in ("", "*/", "*/*/")]
    configs = [config for level in levels for config in level if config.is_file()]
    names = [config.relative_to(path).as_posix().removesuffix(CONFIG_ENDING) for config in configs]
    listed = ", ".join(names[:MAX_LISTED_CONFIGS]) + (", ..." if len(names) > MAX_LISTED_CONFIGS else "")
    if name is not None:
        wanted = PurePosixPath(name).as_posix().removesuffix(CONFIG_ENDING)
        named = [config for config, own in zip(configs, names, strict=True) if own == wanted]
        named = named or [config for config, own in zip(configs, names, strict=True) if PurePosixPath(own).name == wanted]
    else:
        named = next((level for level in levels if level), [])
    if len(named) == 1:
        return named[0]
    field = f"--config {name}" if name is not None else f"*{CONFIG_ENDING}"
    if not configs:
        raise InputError(path.name, field, "there is none", "name the folder of a Habitat scene dataset")
    if not named:
        raise InputError(path.name, field, f"there is none; the folder has {listed}", f"use --config {names[0]}")
    first = named[0].relative_to(path).as_posix().removesuffix(CONFIG_ENDING)
    raise InputError(path.name, field, f"there are {len(named)}: {listed}", f"choose one, for example --config {first}")


def habitat_scenes(root: Path, dataset: str, config: str | None = None) -> list[Source]:
    """Every scene of the dataset in `root`, sorted by scene id; a scene that cannot be read says why.

    config: File name of the scene dataset config; by default, the only one.

    Raises:
        InputError: the folder has no scene dataset config, or several, or one that cannot be read or lists no scene.
    """
    library = read_library(root, config or dataset_config(root).name)
    own = [finding for finding in library.findings if finding.where.split(" ")[0] == library.config]
    notes = [_text(finding) for finding in library.findings if finding in own or finding.where.endswith(ENDINGS["light_setups"])]
    unreadable = [finding for finding in own if finding.rule in ("json", "files_exist") and finding.where == library.config]
    facts = _Facts(library, root, notes)
    sources = [facts.source(template, dataset) for template in library.sections["scene_instances"].values()]
    read = {template.file for template in library.sections["scene_instances"].values()}
    for finding in library.findings:  # a scene file that could not be read is in no section
        if finding.where.endswith(ENDINGS["scene_instances"]) and finding.where not in read:
            name = PurePosixPath(finding.where).name.removesuffix(ENDINGS["scene_instances"])
            files = tuple(path for path in (root / finding.where,) if path.is_file())
            error = InputError(finding.where, finding.rule, finding.message, "export it again")
            sources.append(Source("habitat", root, dataset, name, files, {}, error))
    if not sources:
        problem = (unreadable or own)[0] if own else None
        why = f" ({problem.message})" if problem else ""
        raise InputError(library.config, "scene_instances", f"the dataset lists no scene{why}", "name a dataset with scenes")
    return sorted(sources, key=lambda source: source.scene_id)


class _Facts:
    """What all scenes of a dataset share."""

    def __init__(self, library: Library, root: Path, notes: list[str]) -> None:
        self._library, self._lexicon = library, _lexicons(library, notes)
        self._categories, self._license = _categories(root, notes), _license(root, notes)
        self._notes = notes
        self._shapes: dict[str, list[str]] = {}
        for finding in library.findings:
            if finding.rule in ("json", "shape"):
                self._shapes.setdefault(finding.where, []).append(f"{_text(finding)}: left out")

    def source(self, scene: Template, dataset: str) -> Source:
        """A scene with all that it names."""
        root = self._library.root
        files = {root / scene.file}
        notes: list[str] = [*self._notes, *self._shapes.get(scene.file, [])]
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
        """Templates of the objects by name. Objects whose template cannot be used are left out, with a note for each name."""
        templates: dict[str, dict[str, Any]] = {}
        problems: dict[str, InputError] = {}
        counts: dict[str, int] = {}
        for index, placed in enumerate(scene.values.get("object_instances") or []):
            field = f"object_instances[{index}].template_name"
            name = placed.get("template_name")
            if name is None:
                notes.append(f"{scene.file}: {field}: is missing: left out")
                continue
            counts[name] = counts.get(name, 0) + 1
            if counts[name] > 1:
                continue
            try:
                template = self._template("objects", name, scene.file, field, notes)
                facts = self._described(template, files)
            except InputError as error:
                problems[name] = error
                continue
            notes += self._shapes.get(template.file, [])
            number = template.values.get("semantic_id")
            facts["class_name"] = self._lexicon.get(number, "") if isinstance(number, int) else ""
            facts["category"] = self._categories.get(template.handle) or self._categories.get(PurePosixPath(facts["render"]).stem, "")
            templates[name] = facts
        for name, problem in problems.items():
            reason = f"{problem.file}: {problem.field}: {problem.problem}"
            notes.append(f"{scene.file}: {counted(counts[name], 'object')} of {name!r} left out: {reason}")
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
            if key == "collision_asset" and not stays_in(path, root):
                continue  # the object collides by its own mesh
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


def _lexicons(library: Library, notes: list[str]) -> dict[int, str]:
    """Names of semantic classes by number, of all lexicons that can be read."""
    lexicon: dict[int, str] = {}
    findings: list[Finding] = []
    for path in library.semantics.values():
        if path.endswith(".json") and not path.endswith(".semantic_config.json"):
            document = read_parts(library.root / path, library.root, findings, shapes.LEXICON)
            for item in (document or {}).get("classes") or []:
                if item:
                    lexicon.setdefault(item["id"], item["name"])
    notes += [_text(finding) for finding in findings]
    return lexicon


def _categories(root: Path, notes: list[str]) -> dict[str, str]:
    """Categories by the name of an object, from the tables in `metadata` and `semantics` that have an id and a category."""
    categories: dict[str, str] = {}
    for path in sorted(file for folder in ("metadata", "semantics") for file in (root / folder).glob("*.csv")):
        if not stays_in(path, root):
            continue
        try:
            rows = list(csv.DictReader(io.StringIO(read_text(path, name_of(path, root)))))
        except csv.Error:
            continue  # no table of categories; what it says is not needed to read the scenes
        except InputError as error:
            notes.append(f"{error}: no categories are taken from it")
            continue
        columns: Sequence[str] = list(rows[0]) if rows else ()
        key = next((name for name in _IDS if name in columns), None)
        value = next((name for name in _CATEGORIES if name in columns), None)
        if key and value:
            for row in rows:
                if row[key] and row[value]:
                    categories.setdefault(row[key], row[value])
    return categories


def _license(root: Path, notes: list[str]) -> str | None:
    """First line of the dataset's licence file, None without one."""
    for name in LICENSES:
        if (root / name).is_file():
            try:
                return first_line(root / name, root)
            except InputError as error:
                notes.append(f"{error}: the license is unknown")
    return None
