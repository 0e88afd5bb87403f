"""Rows of the annotation stage: what people chose."""

from __future__ import annotations

from datetime import datetime

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record


@record(
    "annotations", key=("batch_id", "scene_id", "instance_id", "annotator"), stage="annotation", grain="annotation_batch", rule="append"
)
class Annotation:
    """One annotator's answer for one instance. History is kept; the newest batch wins."""

    batch_id: str = column("Annotation batch", pattern=r"[A-Za-z0-9][A-Za-z0-9_.-]*")
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance when the answer was given", pattern=INSTANCE_PATTERN)
    annotator: str = column("Annotator")
    answered_at: datetime = column("When the answer was given")
    choice: str | None = column("Chosen asset; missing when none of the candidates fits", pattern=r"[0-9a-f]{64}")
    pose: tuple[float, ...] | None = column(
        "Asset to world frame as placed by the annotator, 4x4 row by row; missing: as aligned by selection", unit="m", length=16
    )
    scale: tuple[float, ...] | None = column("Scale along the asset's own axes; missing: as aligned by selection", length=3, minimum=0.001)
    ranking: tuple[str, ...] = column("Candidates in the annotator's order, best first; may be partial")
    box_pose: tuple[float, ...] = column("The instance's oriented box when the answer was given, 4x4 row by row", unit="m", length=16)
    box_size: tuple[float, ...] = column("Extents of that box", unit="m", length=3, minimum=0)
    source_file: str = column("File that the answer came from, relative to its batch")
