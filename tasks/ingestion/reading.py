"""A scene of a finished dataset, read and made rows of. A change of the code below this module reads every scene again."""

from __future__ import annotations

from schemas.errors import InputError
from tasks.capture.labels import label_map
from tasks.ingestion.habitat import read_habitat
from tasks.ingestion.metascenes import read_metascenes
from tasks.ingestion.rows import scene_rows
from tasks.ingestion.scene import IngestionConfig, Source
from tasks.micro_scenes import STAGE as MICRO_SCENES
from tasks.micro_scenes import MicroScenesConfig
from tasks.stage import Context, Outcome


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
    rows = scene_rows(scene, source, context, config)
    made = {table: values for outcome in rows.values() for table, values in outcome.rows.items()}
    reads = {table: made[table] for table in MICRO_SCENES.reads}
    rows[MICRO_SCENES.name] = MICRO_SCENES.run(**reads, context=context, config=MicroScenesConfig())
    return rows
