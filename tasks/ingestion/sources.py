"""Which scenes a finished dataset has. What is found travels with each source, so nothing of this is a reason to read one again."""

from __future__ import annotations

from pathlib import Path

from schemas.errors import InputError
from tasks.ingestion.habitat_scenes import habitat_scenes
from tasks.ingestion.metascenes import metascenes_scenes
from tasks.ingestion.scene import Kind, Source


def find_sources(kind: Kind, folder: Path, dataset: str, names: Path | None = None) -> list[Source]:
    """The scenes of a finished dataset, sorted by scene id; one that cannot be read says why in its `problem`.

    names: Folder with `<scan>.json`, names of instances, for releases that have none.

    Raises:
        InputError: the folder does not exist or holds no such dataset.
    """
    try:
        exists = folder.is_dir()
    except OSError as error:
        raise InputError(folder.name, "folder", f"cannot be read ({error.strerror})", "check its permissions") from error
    if not exists:
        raise InputError(str(folder), "folder", "does not exist", "name the folder of the dataset")
    root = folder.resolve()
    all_sources = habitat_scenes(root, dataset) if kind == "habitat" else metascenes_scenes(root, dataset, names)
    by_scene: dict[str, list[Source]] = {}
    for source in all_sources:
        by_scene.setdefault(source.scene_id, []).append(source)
    sources = []
    for scene_id, same in sorted(by_scene.items()):
        if len(same) > 1:
            both = InputError(
                ", ".join(scene_source.scan for scene_source in same), "scene", f"are all scene {scene_id}", "rename all but one"
            )
            same = [Source(kind, root, dataset, same[0].scan, (), {}, both)]
        sources += same
    return sources
