"""Reader of the released MetaScenes layout: meshes where people put them, transformations of a physics engine, layouts.

The facts about that layout, and where they come from, are in docs/ingestion.md.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from schemas.errors import InputError
from schemas.files import stays_in
from tasks.capture.files.documents import first_line, json_kind, name_of, read_bytes
from tasks.capture.labels import Label, LabelMap
from tasks.geometry.meshes import surface_of
from tasks.geometry.transforms import translation
from tasks.ingestion.floors import read_layout
from tasks.ingestion.materials import material_files
from tasks.ingestion.models import ENDINGS, read_model
from tasks.ingestion.scene import (
    MIRROR,
    Array,
    FinishedObject,
    FinishedScene,
    ImportedModel,
    Source,
    is_mirrored,
    mirrored_model,
    scaled_pose,
)
from tasks.ingestion.values import LICENSES, json_document

if TYPE_CHECKING:
    import trimesh

SCENES, SIMULATED, LAYOUTS = "Annotation_scenes", "Physical_simu", "Layout"
"""Folders of a release."""

LABELS = ("instance_id_to_name", "labels")
"""Folders in which names of instances are looked for, `<scan>.json`; a release has none."""

_MATRIX, _LABEL = ("matrix", "pose", "transform"), ("label", "category", "name")
"""Keys of an instance in `Physical_simu`, where it is an object and not the matrix itself."""


def metascenes_scenes(root: Path, dataset: str, names: Path | None = None) -> list[Source]:
    """Every scan of the release in `root`, sorted by scene id; a scan that cannot be read says why.

    names: Folder with `<scan>.json`, names of the instances by their id, where it is not in the release itself.

    Raises:
        InputError: the folder holds no release.
    """
    folder = root / SCENES
    if not folder.is_dir():
        raise InputError(root.name, SCENES, "there is no such folder", "name the folder of a MetaScenes release")
    scans = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    if not scans:
        raise InputError(f"{root.name}/{SCENES}", "folder", "is empty", "name the folder of a MetaScenes release")
    return [_source(root, dataset, scan, names) for scan in scans]


def _source(root: Path, dataset: str, scan: Path, names: Path | None) -> Source:
    meshes: dict[str, str] = {}
    notes: list[str] = []
    files: set[Path] = set()
    problem: InputError | None = None
    try:
        if not stays_in(scan, root):
            raise InputError(name_of(scan, root), "folder", "leads out of the dataset", "copy it in")
        for folder in sorted(path for path in scan.iterdir() if path.is_dir() and not path.name.startswith(".")):
            mesh = _mesh_file(folder)
            if mesh is None:
                notes.append(f"{name_of(folder, root)}: holds no mesh: left out")
                continue
            if not stays_in(mesh, root):
                notes.append(f"{name_of(mesh, root)}: leads out of the dataset's folder: left out")
                continue
            meshes[folder.name] = mesh.relative_to(root).as_posix()
            files |= {mesh, *material_files(mesh, root)}
        if not meshes:
            raise InputError(name_of(scan, root), "instances", "there is none with a mesh", "unpack the release again")
    except OSError as error:
        problem = InputError(name_of(scan, root), "folder", f"cannot be read ({error.strerror})", "check its permissions")
    except InputError as error:
        problem = error
    simulated = root / SIMULATED / f"{scan.name}.json"
    layouts = sorted((root / LAYOUTS).glob(f"*/{scan.name}.json"), key=lambda path: (path.parent.name == "Heuristic", path.as_posix()))
    named = next((p for p in (*([names / f"{scan.name}.json"] if names else []), *(root / n / f"{scan.name}.json" for n in LABELS))
                  if p.is_file()), None)  # fmt: skip
    licenses = [root / name for name in LICENSES if (root / name).is_file()][:1]
    about = {
        "meshes": meshes,
        "simulated": simulated.relative_to(root).as_posix() if simulated.is_file() else "",
        "layouts": [path.relative_to(root).as_posix() for path in layouts],
        # Names may lie outside of the release; their content counts, so it is kept here.
        "names": "",
        "notes": notes,
    }
    if named is not None and problem is None:
        try:
            about["names"] = read_bytes(named, named.name, 16 * 2**20).decode("utf-8", "replace")
            about["names_file"] = named.name
        except InputError as error:
            problem = error
    files |= {path for path in (simulated, *layouts, *licenses) if path.is_file() and stays_in(path, root)}
    about["license"] = licenses[0].name if licenses else ""
    return Source("metascenes", root, dataset, scan.name, tuple(sorted(files)), about, problem)


def _mesh_file(folder: Path) -> Path | None:
    """The mesh of an instance: named like its folder, else `mesh`, else the only one there is."""
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in ENDINGS and not path.name.startswith("."))
    for stem in (folder.name, "mesh"):
        same = [path for path in paths if path.stem == stem]
        if same:
            return min(same, key=lambda path: ENDINGS.index(path.suffix.lower()))
    return paths[0] if len(paths) == 1 else None


def read_metascenes(source: Source, labels: LabelMap) -> FinishedScene:
    """A scan with its objects, where people put them and where the dataset's physics engine moved them, and its floor.

    An object whose mesh cannot be read is left out, and one whose matrix is of no use stays where people put it; notes say so.

    Raises:
        InputError: a file of the whole scan cannot be used, or none of its objects; names file and field.
    """
    root, about = source.root, source.about
    notes = list(about["notes"])
    matrices, remarks, more = _simulated(source)
    names, unnamed = _names(source)
    names, notes = names | remarks, [*notes, *more, *unnamed]
    unknown = sorted(set(matrices) - set(about["meshes"]))
    notes += [f"{about['simulated']}: matrix.{name}: there is no such object: left out" for name in unknown]
    if not about["simulated"]:
        notes.append(f"{source.scan}: no transformations in {SIMULATED}: objects are where people put them")
    license = first_line(root / about["license"], root) if about["license"] else None
    ids = instance_ids(list(about["meshes"]))
    objects = []
    broken: list[InputError] = []
    for name, file in about["meshes"].items():
        try:
            parts, more = read_model(root / file, root, is_z_up=True)
        except InputError as error:
            broken.append(error)
            continue
        notes += more
        label = labels[names.get(name, "")]
        if not names.get(name):
            label = Label("unlabeled", 0, is_known=False)
        elif not label.is_known:
            notes.append(f"{about.get('names_file') or about['simulated']}: {names[name]!r} is not in the label map, nyu40 class 0")
        instance, more = _object(
            name, ids[name], parts, file, names.get(name, ""), label, license, matrices.get(name), str(about["simulated"])
        )
        objects.append(instance)
        notes += more
    if not objects:
        raise broken[0]
    notes += [f"{error}: the object is left out" for error in broken]
    if not any(names.get(name) for name in about["meshes"]):
        notes.append(f"{source.scan}: no names of instances: every category is unlabeled; give them with --labels")
    layout, more = read_layout([root / path for path in about["layouts"]], root, objects)
    return FinishedScene(
        objects=tuple(sorted(objects, key=lambda instance: instance.instance_id)),
        stage=(),
        layout=layout,
        alignment=np.eye(4),
        room_type="",
        license=license,
        notes=tuple(dict.fromkeys([*notes, *more])),
    )


def instance_ids(names: list[str]) -> dict[str, str]:
    """Zero-padded ids of instances by their names: a number is its own id, others (`7-1`) follow after the highest."""
    numbers = {name: int(name) for name in names if re.fullmatch(r"0|[1-9][0-9]{0,5}", name)}
    taken: dict[int, str] = {}
    for name, number in sorted(numbers.items(), key=lambda item: (item[1], item[0])):
        taken.setdefault(number, name)
    ids = {name: f"{number:04d}" for number, name in taken.items()}
    following = max(taken, default=-1) + 1
    in_numbers = {name: [int(n) if n.isdigit() else -1 for n in re.split(r"\D+", name)] + [0] for name in set(names) - set(ids)}
    for name in sorted(in_numbers, key=lambda name: (in_numbers[name], name)):
        ids[name] = f"{following:04d}"
        following += 1
    return ids


def _object(
    name: str, instance_id: str, parts: list[trimesh.Trimesh], file: str, raw: str, label: Label, license: str | None,
    matrix: Array | None, simulated: str,
) -> tuple[FinishedObject, list[str]]:  # fmt: skip
    """An instance: its mesh about the center of its box, the pose that people gave it, and the one of the physics engine.

    A matrix that mirrors the object mirrors its mesh. One that cannot be used leaves the object where people put it.
    """
    center = surface_of(parts).bounds.mean(axis=0)
    for part in parts:
        part.apply_translation(-center)
    model = ImportedModel(tuple(parts), (), f"{file.split('/')[-3]}_{name}", file, license or "unknown")
    annotated = translation(center)
    notes: list[str] = []
    remains = "the dataset's physics engine has no pose for it" if simulated and matrix is None else None
    if matrix is not None:
        field = f"matrix.{name}"
        try:
            pose, scale = scaled_pose(matrix @ MIRROR if is_mirrored(matrix) else matrix, simulated, field)
        except InputError as error:
            notes.append(f"{error}: the object stays where people put it")
            matrix, remains = None, "the pose of the dataset's physics engine cannot be used"
    if matrix is None:
        own = FinishedObject(instance_id, name, raw, label, model, annotated, np.ones(3), is_annotated=True, remains=remains)
        return own, notes
    if is_mirrored(matrix):
        model = mirrored_model(model)
        notes.append(f"{simulated}: {field}: mirrors the object: its mesh is mirrored")
    # Matrices are written with few digits: a scale of 1 up to rounding is 1.
    scale = np.where(np.abs(scale - 1.0) < 1e-4, 1.0, scale)
    return FinishedObject(instance_id, name, raw, label, model, pose, scale, annotated, is_annotated=True), notes


def _simulated(source: Source) -> tuple[dict[str, Array], dict[str, str], list[str]]:
    """Matrices and labels by instance, as `Physical_simu` has them, and a note on every matrix that is none."""
    file = str(source.about["simulated"])
    if not file:
        return {}, {}, []
    document = json_document(source.root / file, source.root)
    if not isinstance(document, dict):
        raise InputError(file, "content", f"is {json_kind(document)}, not an object", "is it the right file?")
    listed = document.get("matrix", document)
    if not isinstance(listed, dict):
        raise InputError(file, "matrix", f"is {json_kind(listed)}, not an object", "give a matrix for every instance id")
    matrices: dict[str, Array] = {}
    labels: dict[str, str] = {}
    notes: list[str] = []
    for name, value in listed.items():
        stretch: Any = None
        if isinstance(value, dict):
            stated: Mapping[str, Any] = value
            label = next((stated[key] for key in _LABEL if isinstance(stated.get(key), str)), "")
            labels |= {name: label} if label else {}
            stretch = stated.get("scale")
            value = next((stated[key] for key in _MATRIX if key in stated), None)
        try:
            matrices[name] = _matrix(value, stretch, file, f"matrix.{name}")
        except InputError as error:
            notes.append(f"{error}: the object stays where people put it")
    return matrices, labels, notes


def _matrix(value: Any, stretch: Any, file: str, field: str) -> Array:
    """A 4x4 matrix given as 4 rows of 4 numbers or 16 numbers, with a scale beside it where there is one."""
    if value is None:
        raise InputError(file, field, "has no matrix", "give 4 rows of 4 numbers")
    try:
        matrix = np.asarray(value, dtype=np.float64)
        scale = np.ones(3) if stretch is None else np.broadcast_to(np.asarray(stretch, dtype=np.float64), 3)
    except (TypeError, ValueError):
        raise InputError(file, field, "is no matrix of numbers", "give 4 rows of 4 numbers") from None
    if matrix.shape not in ((4, 4), (16,)):
        raise InputError(file, field, f"has shape {matrix.shape}", "give 4 rows of 4 numbers")
    return matrix.reshape(4, 4) @ np.diag([*scale, 1.0])


def _names(source: Source) -> tuple[dict[str, str], list[str]]:
    """Names of instances, from a list by their number or an object by their id, and a note on what is no name."""
    if not source.about["names"]:
        return {}, []
    file = str(source.about["names_file"])
    document = json_document(file, None, str(source.about["names"]).encode())
    if isinstance(document, list):
        document = {str(index): item for index, item in enumerate(document)}
    if not isinstance(document, dict):
        raise InputError(file, "content", "is neither a list of names nor an object of them", "give the name of every instance")
    names = {name: item for name, item in document.items() if isinstance(item, str)}
    return names, [f"{file}: {name}: is {json_kind(item)}, not a name" for name, item in document.items() if name not in names]
