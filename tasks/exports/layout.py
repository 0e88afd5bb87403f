"""How exported files of many scenes become one folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath

from schemas.errors import InputError
from schemas.exports import ExportFile
from tasks.exports.files import File
from tasks.exports.habitat.dataset import HabitatScene, dataset_files, describe


def layout(rows: Sequence[ExportFile]) -> dict[str, str]:
    """Name of the blob of every file, by path `<format>/<path>` from the export's root, forward slashes, sorted.

    Raises:
        InputError: a path leaves the folder, or two scenes have different files at one path.
    """
    found: dict[str, str] = {}
    for row in rows:
        path = PurePosixPath(row.path)
        if path.is_absolute() or ".." in path.parts or "\\" in row.path or not row.path:
            raise InputError("export_files", f"{row.scene_id} path", f"{row.path!r} leaves the folder", "run exports again")
        name = f"{row.format}/{path}"
        if found.setdefault(name, row.file_blob) != row.file_blob:
            raise InputError("export_files", f"{row.scene_id} path", f"{row.path!r} is another scene's file too", "export the scenes apart")
    return dict(sorted(found.items()))


def shared_files(rows: Sequence[ExportFile], blobs: Mapping[str, bytes]) -> dict[str, bytes]:
    """Files that belong to no scene alone, by path from the export's root: those of the Habitat dataset."""
    scenes: dict[str, dict[str, ExportFile]] = {}
    for row in rows:
        if row.format == "habitat":
            scenes.setdefault(row.scene_id, {})[row.path] = row
    described = [_described(scenes[scene_id], blobs) for scene_id in sorted(scenes)]
    return {f"habitat/{path}": data for path, data in dataset_files(described).items()} if described else {}


def dataset_of(files: Sequence[File]) -> dict[str, bytes]:
    """The same for a dataset of one scene, whose files are at hand; by path from the dataset's root."""
    contents = {file.path: file.data for file in files}
    return dataset_files([describe({file.path: file.role for file in files}, contents.__getitem__)])


def _described(rows: Mapping[str, ExportFile], blobs: Mapping[str, bytes]) -> HabitatScene:
    """A scene by its rows, by path."""
    return describe({path: row.role for path, row in rows.items()}, lambda path: blobs[rows[path].file_blob])
