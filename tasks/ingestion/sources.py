"""Which scenes a finished dataset has. What is found travels with each source, so nothing of this is a reason to read one again."""

from __future__ import annotations

from pathlib import Path

from schemas.errors import InputError
from tasks.ingestion.habitat_scenes import dataset_config, habitat_scenes
from tasks.ingestion.metascenes import metascenes_scenes
from tasks.ingestion.scene import Kind, Source


def find_sources(kind: Kind, folder: Path, dataset: str, names: Path | None = None, config: str | None = None) -> list[Source]:
    """The scenes of a finished dataset, sorted by scene id; one that cannot be read says why in its `problem`.

    folder: Folder of the dataset; of Habitat datasets also a scene dataset config, or a folder above exactly one.
    names: Folder with `<scan>.json`, names of instances, for releases that have none.
    config: Name of the scene dataset config, where a folder has several.

    Raises:
        InputError: the folder does not exist or holds no such dataset.
    """
    try:
        exists = folder.is_dir() or (kind == "habitat" and folder.is_file())
    except OSError as error:
        raise InputError(folder.name, "folder", f"cannot be read ({error.strerror})", "check its permissions") from error
    if not exists:
        raise InputError(str(folder), "folder", "does not exist", "name the folder of the dataset")
    root = folder.resolve()
    chosen = dataset_config(root if root.is_dir() else folder.absolute(), config) if kind == "habitat" else None
    root = chosen.parent.resolve() if chosen is not None else root
    all_sources = habitat_scenes(root, dataset, chosen.name) if chosen is not None else metascenes_scenes(root, dataset, names)
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
