"""Targets of a walk: an object, a scene, an asset, a model, a blob, an exported file, or an object in one."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from typing import Literal

from schemas.capture import Scene
from schemas.errors import InputError
from schemas.exports import ExportFile
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.record import BLOB_PATTERN, INSTANCE_PATTERN, SCENE_PATTERN, arrow_to_rows
from schemas.training import LearnedModel
from schemas.wording import meant
from warehouse.tables.snapshot import Reader

_FORMS = "give <scene>/<instance>, a scene, the hash of an asset or a model, the name of a blob, or the path of an exported file"


@dataclasses.dataclass(frozen=True)
class Target:
    """What is asked after. `object` is the name of an object in an exported file: in USD a prim path.

    `files` are the rows of an exported file, one per scene that has it.
    """

    kind: Literal["instance", "scene", "asset", "model", "blob", "export"]
    key: str = ""
    scene_id: str = ""
    instance_id: str = ""
    files: tuple[ExportFile, ...] = ()
    obj: str | None = None


def find_target(reader: Reader, address: str, asked: str) -> Target:
    """The target that a text names in a snapshot. `address` is the lake's, for messages.

    Raises:
        InputError: they mean nothing, nothing that is there, or more than one of these.
    """
    if re.fullmatch(BLOB_PATTERN, asked):
        return Target("blob", key=asked)
    if re.fullmatch(r"[0-9a-f]{64}", asked):
        return Target("model" if reader.rows_by_key(LearnedModel, [asked]) else "asset", key=asked)
    scene, _, last = asked.rpartition("/")
    if scene and re.fullmatch(INSTANCE_PATTERN, last):
        full_id = _scenes(reader, address, asked, scene)
        if full_id:
            return Target("instance", scene_id=full_id, instance_id=last)
    full_id = _scenes(reader, address, asked, asked)
    if full_id:
        return Target("scene", scene_id=full_id)
    path, obj = split_object(asked)
    files = export_files(reader, path)
    if not files and obj is not None:  # a file whose name holds a colon
        files, obj = export_files(reader, asked), None
    if files:
        return Target("export", files=files, obj=obj)
    known = reader.matching("scenes", {}, ["scene_id"]).column("scene_id").to_pylist()
    word = scene if scene and re.fullmatch(INSTANCE_PATTERN, last) else asked
    near = meant(word, known if "/" in word else [scene_id.rpartition("/")[2] for scene_id in known])
    raise InputError(address, "explain", f"snapshot {reader.snapshot_id} has nothing that is called {asked!r}", f"{near}{_FORMS}")


def split_object(asked: str) -> tuple[str, str | None]:
    """The path of a file and what is named in it, None where nothing is: ``scene.usda:/World/Objects/bed_0009``."""
    path, colon, obj = asked.partition(":/")
    if colon:
        return path, f"/{obj}"
    path, colon, obj = asked.rpartition(":")
    return (path, obj) if colon and path else (asked, None)


def export_files(reader: Reader, path: str) -> tuple[ExportFile, ...]:
    """Rows of an exported file by its path in a folder, `.../<format>/<path of the row>`, sorted by scene; empty where there is none.

    The scene is read off the path where it can be: a path alone is looked for in the exports of all scenes.
    """
    parts = [part for part in path.replace("\\", "/").split("/") if part not in ("", ".")]
    wanted = {(parts[i - 1] if i else None, "/".join(parts[i:])) for i in range(len(parts))}
    exact = {(name, tail) for name, tail in wanted if name in EXPORT_FORMATS}
    tails = {tail for _, tail in exact or wanted}
    if not tails:
        return ()
    named = [row.scene_id for row in reader.rows_by_key(Scene, sorted(set(_scene_names(parts))))]
    rows: list[ExportFile] = []
    for scene_id in named:
        rows += [row for row in reader.rows(ExportFile, scene_id) if row.path in tails]
    if not rows:
        rows = arrow_to_rows(reader.matching("export_files", {"path": sorted(tails)}), ExportFile)
    if exact:
        rows = [row for row in rows if (row.format, row.path) in exact]
    longest = max((len(row.path) for row in rows), default=0)
    return tuple(sorted((row for row in rows if len(row.path) == longest), key=lambda row: (row.format, row.scene_id)))


def _scene_names(parts: list[str]) -> Iterator[str]:
    """Scenes that the parts of a path may be named after: exports write ``demo/scene0000_00`` as ``demo_scene0000_00``."""
    for part in parts:
        words = part.split(".")[0].split("_")
        for end in range(2, len(words) + 1):
            for cut in range(1, end):
                name = f"{'_'.join(words[:cut])}/{'_'.join(words[cut:end])}"
                if re.fullmatch(SCENE_PATTERN, name):
                    yield name


def _scenes(reader: Reader, address: str, asked: str, name: str) -> str | None:
    """The scene of a name, `<dataset>/<scan>` or the scan alone; None where there is none."""
    if re.fullmatch(SCENE_PATTERN, name):
        rows = reader.rows_by_key(Scene, [name])
        return rows[0].scene_id if rows else None
    if "/" in name:
        return None
    matches = [row["scene_id"] for row in reader.matching("scenes", {"scan": [name]}, ["scan"]).to_pylist()]
    if len(matches) > 1:
        raise InputError(address, "explain", f"{asked!r} may be of {', '.join(matches[:5])}", "name the dataset, too")
    return matches[0] if matches else None
