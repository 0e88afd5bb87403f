"""Rows of the selection stage: every candidate's score and its pose on the instance."""

from __future__ import annotations

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record


@record("selections", key=("scene_id", "instance_id", "rank"), stage="selection")
class Selection:
    """A candidate of an instance, aligned to it and scored; rank 1 is the choice."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    rank: int = column("Rank by score, 1 is the choice; an asset that does for several that look alike goes first", minimum=1)
    slot: int = column("Slot of the candidate", minimum=1, maximum=10)
    asset_id: str = column("Asset", pattern=r"[0-9a-f]{64}")
    score: float = column("Weighted geometric score, higher is better", minimum=0, maximum=1)
    chamfer_m: float = column("Mean of the two mean nearest distances, asset surface and instance points", unit="m", minimum=0)
    coverage: float = column("Share of the instance's points within the distance threshold of the asset's surface", minimum=0, maximum=1)
    box_iou: float = column(
        "Intersection over union of the placed asset's box and the instance's box with its hidden_m", minimum=0, maximum=1
    )
    foreign_share: float | None = column(
        "Of the 4 cm cubes in which the instance was seen, and those within the asset that others or the free space above the floor "
        "were seen in, the share of the latter; missing where nobody looked",
        minimum=0,
        maximum=1,
    )
    color_similarity: float = column("1 - Jensen-Shannon distance of the color histograms", minimum=0, maximum=1)
    pose: tuple[float, ...] = column("Asset to world frame, rotation about +Z, 4x4 row by row", unit="m", length=16)
    scale: tuple[float, ...] = column("Scale along the asset's own axes, applied before the pose", length=3, minimum=0.001)
    look: str | None = column(
        "First of the instances of its category that one asset was chosen for, since it fits each nearly as well as its best; null alone",
        pattern=INSTANCE_PATTERN,
    )
    provider: str = column("Who scored")
    provider_version: str = column("Version of the scoring")
