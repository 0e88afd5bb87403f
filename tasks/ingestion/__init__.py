"""Ingestion: finished datasets of others in; rows of the lake's tables out, as if the lake had made them, saying that it did not."""

from __future__ import annotations

from pathlib import Path

from schemas.errors import InputError
from tasks.capture.labels import label_map
from tasks.ingestion.habitat import read_habitat
from tasks.ingestion.habitat_scenes import habitat_scenes
from tasks.ingestion.metascenes import metascenes_scenes, read_metascenes
from tasks.ingestion.rows import STAGES, scene_rows
from tasks.ingestion.scene import KINDS, IngestionConfig, Kind, Source
from tasks.stage import Context, Outcome

__all__ = ["KINDS", "STAGES", "IngestionConfig", "Kind", "Source", "find_sources", "ingest"]


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
        raise InputError(folder.name or str(folder), "folder", "does not exist", "name the folder of the dataset")
    root = folder.resolve()
    found = habitat_scenes(root, dataset) if kind == "habitat" else metascenes_scenes(root, dataset, names)
    by_scene: dict[str, list[Source]] = {}
    for source in found:
        by_scene.setdefault(source.scene_id, []).append(source)
    sources = []
    for scene_id, same in sorted(by_scene.items()):
        if len(same) > 1:
            both = InputError(", ".join(one.scan for one in same), "scene", f"are all scene {scene_id}", "rename all but one")
            same = [Source(kind, root, dataset, same[0].scan, (), {}, both)]
        sources += same
    return sources


def ingest(source: Source, context: Context, config: IngestionConfig) -> dict[str, Outcome]:
    """Rows of a scene by stage, in the order of the data path; stages of which the dataset knows nothing are not there.

    Raises:
        InputError: a file of the scene cannot be used, or a value in it makes no sense; names both.
    """
    if source.problem is not None:
        raise source.problem
    labels = label_map(config.label_map)
    scene = read_habitat(source, labels) if source.kind == "habitat" else read_metascenes(source, labels)
    if not scene.objects and not scene.stage:
        raise InputError(source.scan, "objects", "there is nothing in the scene", "is it the right folder?")
    return scene_rows(scene, source, context, config)
