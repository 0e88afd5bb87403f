"""A Habitat dataset on disk as habitat-sim would look things up in it: templates, scenes, navmeshes, lexicons, by name."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.parsing import json_value
from tasks.exports.findings import Finding
from tasks.exports.habitat import shapes
from tasks.unpacking import gunzip

ENDINGS = {
    "stages": ".stage_config.json", "objects": ".object_config.json", "light_setups": ".lighting_config.json",
    "scene_instances": ".scene_instance.json",
}  # fmt: skip
"""Sections of a scene dataset config whose files this knows, and how those files' names end."""


CONFIG_ENDING = ".scene_dataset_config.json"
"""End of the file name of a scene dataset config."""

LIGHTS = "_lights"
"""How the names of a scene's lights end in datasets of this project; they begin with the scene's."""


@dataclasses.dataclass(frozen=True)
class Template:
    """A stage, an object or a scene: the file that says what it is, what is said (defaults included), where paths start."""

    handle: str
    file: str
    values: Mapping[str, Any]
    folder: Path


@dataclasses.dataclass(frozen=True)
class Library:
    """Everything that can be looked up by name, and what was wrong with the files on the way."""

    root: Path
    config: str
    sections: Mapping[str, Mapping[str, Template]]
    navmeshes: Mapping[str, str]
    semantics: Mapping[str, str]
    findings: tuple[Finding, ...]

    @cached_property
    def is_ours(self) -> bool:
        """Whether this project wrote the dataset, as its scenes say; in those of others what is a matter of taste is a warning."""
        scenes = self.sections["scene_instances"].values()
        return (self.root / "metadata" / "agent.json").is_file() or any("scene_id" in (s.values.get("user_defined") or {}) for s in scenes)

    @cached_property
    def _lit(self) -> tuple[str, ...]:
        """Scenes that have lights of their own, by the names of their lights."""
        names = [PurePosixPath(name).name for name in self.sections["light_setups"]]
        return tuple(f"{name.removesuffix(LIGHTS)}_" for name in names if name.removesuffix(LIGHTS)) if self.is_ours else ()

    def is_lit(self, template: Template) -> bool:
        """Whether this project wrote a template since scenes have lights. What it asks for since then is a warning in older ones.

        A dataset may hold scenes of both kinds; names of stages, objects and scenes begin with their scene's.
        """
        return f"{PurePosixPath(template.handle).name}_".startswith(self._lit)

    def scene_of(self, scene_id: Any) -> str | None:
        """Name of the scene that an episode's `scene_id` opens, None for none.

        In a dataset of this project it is that name. Others also give a path to the scene's file, or to a stage that is
        opened as a scene.
        """
        scenes, stages = self.sections["scene_instances"], self.sections["stages"]
        if not isinstance(scene_id, str) or scene_id in scenes or self.is_ours:
            return scene_id if isinstance(scene_id, str) and scene_id in scenes else None
        name = PurePosixPath(scene_id).name.removesuffix(ENDINGS["scene_instances"]).removesuffix(".glb")
        return name if name in scenes or name in stages else None


def read_library(root: Path, config: str | None = None) -> Library:
    """Read a scene dataset config of a folder and all that it lists. config: its file's name; by default, the only one."""
    findings: list[Finding] = []
    configs = sorted(root.glob(f"*{CONFIG_ENDING}")) if config is None else [root / config]
    if len(configs) != 1:
        names = f" ({', '.join(path.name for path in configs)})" if configs else ""
        findings.append(Finding("dataset_config", ".", f"*{CONFIG_ENDING}: there are {len(configs)}{names}, not one"))
    if not configs:
        return Library(root, "", {name: {} for name in ENDINGS}, {}, {}, tuple(findings))
    document = read_parts(configs[0], root, findings, shapes.CONFIG) or {}
    known = {*ENDINGS, "articulated_objects", "pbr_ibl_configs", "navmesh_instances", "semantic_scene_descriptor_instances"}
    for name in sorted(set(document) - known):
        findings.append(Finding("dataset_config", configs[0].name, f"section {name!r} is not read by habitat-sim"))
    sections = {name: _section(root, document.get(name, {}), name, configs[0].name, findings) for name in ENDINGS}
    semantics = dict(document.get("semantic_scene_descriptor_instances", {}))
    patterns = semantics.pop("paths", {})
    semantics.pop("default_attributes", None)
    semantics = _inside(semantics, "semantic_scene_descriptor_instances", configs[0].name, findings)
    for pattern in (p for paths in patterns.values() for p in paths):
        for file in _matches(root, pattern, "semantic_scene_descriptor_instances", configs[0].name, findings):
            semantics[file.name] = file.relative_to(root).as_posix()
    navmeshes = _inside(document.get("navmesh_instances", {}), "navmesh_instances", configs[0].name, findings)
    return Library(root, configs[0].name, sections, navmeshes, semantics, tuple(findings))


def _leaves(path: str) -> bool:
    """Whether a path or pattern leads out of the folder that it starts in."""
    return Path(path).is_absolute() or ".." in Path(path).parts


def _inside(named: Mapping[str, str], kind: str, file: str, findings: list[Finding]) -> dict[str, str]:
    """Files by name, but for those outside the dataset's folder."""
    for name, path in named.items():
        if _leaves(path):
            findings.append(Finding("dataset_config", file, f"{kind}: {name}: {path} leaves the dataset's folder"))
    return {name: path for name, path in named.items() if not _leaves(path)}


def _matches(root: Path, pattern: str, kind: str, file: str, findings: list[Finding]) -> list[Path]:
    """What a pattern in the dataset config matches, sorted."""
    if _leaves(pattern):
        findings.append(Finding("dataset_config", file, f"{kind}: {pattern} leaves the dataset's folder"))
        return []
    try:
        paths = sorted(root.glob(pattern))
    except ValueError as error:  # such as an empty one
        findings.append(Finding("dataset_config", file, f"{kind}: {pattern!r} is no pattern ({error})"))
        return []
    if not paths:
        findings.append(Finding("files_exist", file, f"{kind}: {pattern} matches no file"))
    return paths


def read_json(path: Path, root: Path, findings: list[Finding], shape: Mapping[str, Any]) -> Any:
    """A JSON file (compressed when its name ends in .gz) of a shape (`habitat_shapes`), or None and a finding."""
    document = _parsed(path, root, findings, _refuse)
    wrong = None if document is None else shapes.mismatch(document, shape)
    if wrong is None:
        return document
    findings.append(Finding("shape", path.relative_to(root).as_posix(), wrong))
    return None


def read_parts(path: Path, root: Path, findings: list[Finding], shape: Mapping[str, Any]) -> Any:
    """The parts of a JSON file that have a shape, and a finding for each other part; None if it cannot be read."""
    where = path.relative_to(root).as_posix()
    constants: list[str] = []
    document = _parsed(path, root, findings, constants.append)  # NaN becomes null, which no number may be
    if document is None:
        return None
    findings += [Finding("json", where, f"{name} is not valid JSON") for name in dict.fromkeys(constants)]
    parts, problems = shapes.conforming(document, shape)
    findings += [Finding("shape", where, problem) for problem in problems]
    return parts


def _parsed(path: Path, root: Path, findings: list[Finding], on_constant: Callable[[str], Any]) -> Any:
    """The value of a JSON file (compressed when its name ends in .gz), or None and a finding."""
    where = path.relative_to(root).as_posix()
    try:
        data = read_file(path, where, BUDGET.json_bytes)
        document = json_value(gunzip(data) if path.suffix == ".gz" else data, parse_constant=on_constant)
        if document is not None:
            return document
        findings.append(Finding("shape", where, "the file is no object"))
    except InputError as error:
        missing = isinstance(error.__cause__, FileNotFoundError)
        findings.append(Finding("files_exist" if missing else "json", where, "does not exist" if missing else error.problem))
    except (OSError, EOFError, ValueError, zlib.error) as error:
        findings.append(Finding("json", where, f"cannot be read ({type(error).__name__}: {error})"[:200]))
    return None


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is no JSON")


def _section(root: Path, section: Any, kind: str, file: str, findings: list[Finding]) -> dict[str, Template]:
    """Templates of one section, in habitat-sim's order: defaults, files, then entries written in the config itself."""
    defaults, problems = shapes.conforming(section.get("default_attributes", {}), shapes.SECTIONS[kind], f"{kind}.default_attributes")
    findings += [Finding("shape", file, problem) for problem in problems]
    ending = ENDINGS[kind]
    templates: dict[str, Template] = {}
    for path in _listed(root, section.get("paths", {}), ending, kind, file, findings):
        shape = shapes.SECTIONS[kind]
        values = read_parts(path, root, findings, shape) if path.name.endswith(ending) else {"render_asset": path.name}
        if values is not None:
            handle = path.name.removesuffix(ending).removesuffix(".glb")
            if handle in templates:
                findings.append(Finding("handle_exact", path.relative_to(root).as_posix(), f"{handle!r} is the name of two files"))
            templates[handle] = Template(handle, path.relative_to(root).as_posix(), {**defaults, **values}, path.parent)
    for entry in section.get("configs", []):
        if not entry:  # one that is wrong, or says nothing
            continue
        origin = entry.get("original_file")
        handle = entry.get("template_handle") or Path(str(origin)).name.removesuffix(ending)
        base = next((t for t in templates.values() if t.file == origin), None)
        if origin and base is None:
            findings.append(Finding("files_exist", file, f"{origin} is changed by the config, but not loaded"))
        values, problems = shapes.conforming({**(base.values if base else defaults), **entry.get("attributes", {})}, shapes.SECTIONS[kind])
        findings += [Finding("shape", f"{file} {handle}", problem) for problem in problems]
        templates[handle] = Template(handle, file, values, base.folder if base else root)
    return templates


def _listed(root: Path, paths: Any, ending: str, kind: str, file: str, findings: list[Finding]) -> Iterator[Path]:
    """Files that a section's `paths` name, each once: by themselves, by pattern, or all of a folder."""
    seen: set[Path] = set()
    for extension, patterns in sorted(paths.items()):
        wanted = ending if extension == ".json" else extension
        for pattern in patterns:
            for match in _matches(root, pattern, kind, file, findings):
                try:
                    below = sorted(match.iterdir()) if match.is_dir() else [match]
                except OSError as error:
                    findings.append(Finding("files_exist", file, f"{kind}: {pattern} cannot be read ({error.strerror})"))
                    continue
                listed = [path for path in below if path.name.endswith(wanted) and path not in seen]
                seen.update(listed)
                yield from listed
