"""How exported files of many scenes become one folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePosixPath

from schemas.errors import InputError
from schemas.exports import ExportFile
from tasks.exports.formats import FORMATS


def layout(rows: Sequence[ExportFile]) -> dict[str, str]:
    """Name of the blob of every file, by path `<format>/<path>` from the export's root, forward slashes, sorted.

    Raises:
        InputError: a path leaves the folder, or two scenes have different files at one path.
    """
    names: dict[str, str] = {}
    for row in rows:
        path = PurePosixPath(row.path)
        if path.is_absolute() or ".." in path.parts or "\\" in row.path or not row.path:
            raise InputError("export_files", f"{row.scene_id} path", f"{row.path!r} leaves the folder", "run exports again")
        name = f"{row.format}/{path}"
        if names.setdefault(name, row.file_blob) != row.file_blob:
            raise InputError("export_files", f"{row.scene_id} path", f"{row.path!r} is another scene's file too", "export the scenes apart")
    return dict(sorted(names.items()))


def shared_files(rows: Sequence[ExportFile], blobs: Mapping[str, bytes]) -> dict[str, bytes]:
    """Files that belong to no scene alone, by path from the export's root: those of a dataset."""
    shared: dict[str, bytes] = {}
    for format_ in FORMATS:
        scenes: dict[str, dict[str, ExportFile]] = {}
        for row in rows:
            if row.format == format_.name:
                scenes.setdefault(row.scene_id, {})[row.path] = row
        if format_.shared is not None and scenes:
            files = format_.shared([_described(scenes[scene_id], blobs) for scene_id in sorted(scenes)])
            shared |= {f"{format_.name}/{path}": data for path, data in files.items()}
    return shared


def _described(rows: Mapping[str, ExportFile], blobs: Mapping[str, bytes]) -> tuple[Mapping[str, str], Callable[[str], bytes]]:
    """Roles of a scene's files by path, and what reads them."""
    return {path: row.role for path, row in rows.items()}, lambda path: blobs[rows[path].file_blob]
