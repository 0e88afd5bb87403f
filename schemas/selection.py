"""Rows of the selection stage: every candidate's score and its pose on the instance. And what methods chose where the truth is known."""

from __future__ import annotations

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record
from schemas.training import HASH, TRAINING_PATTERN


@record("selections", key=("scene_id", "instance_id", "rank"), stage="selection")
class Selection:
    """A candidate of an instance, aligned to it and scored; rank 1 is the choice."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    rank: int = column("Rank by score, 1 is the choice; an asset that does for several that look alike goes first", minimum=1)
    slot: int = column("Slot of the candidate", minimum=1, maximum=10)
    asset_id: str = column("Asset", pattern=r"[0-9a-f]{64}")
    score: float = column(
        "Score by the provider, higher is better: agreement of 0 to 1, the same up to a stated distance from it, by which a model chooses, "
        "or the chance of a candidate among those of its instance",
        minimum=0,
        maximum=1,
    )
    chamfer_m: float = column("Mean of the two mean nearest distances, asset surface and instance points", unit="m", minimum=0)
    coverage: float = column("Share of the instance's points within the distance threshold of the asset's surface", minimum=0, maximum=1)
    box_iou: float = column(
        "Intersection over union of the placed asset's box and the instance's box with its hidden_m", minimum=0, maximum=1
    )
    foreign_share: float | None = column(
        "Of the 4 cm cubes in which the instance was seen, and those within the asset that others or the free space above the floor "
        "were seen in or that the frames saw empty, the share of the latter; missing where nobody looked",
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
    provider: str = column("Method that scored; geometric where the one that was asked for lacked what it needs")
    provider_version: str = column(
        "Version of the method, and behind colons which weights or model scored, and among which, where it has any"
    )


@record(
    "selection_outcomes",
    key=("training_id", "method", "seed", "dataset", "scene_id", "instance_id"),
    stage="training",
    grain="dataset",
    rule="append",
)
class SelectionOutcome:
    """What a selection method chose for an instance of which the scanned model is known, and how far it is from that (specs C.5)."""

    training_id: str = column("Training that measured it", pattern=TRAINING_PATTERN)
    model_id: str | None = column("Model that scored; null for a method that learns nothing", pattern=HASH)
    method: str = column("Method, or variant of the model, that scored")
    seed: int = column("Seed that the method was trained with; 0 where it draws nothing")
    dataset: str = column("Examples that it was measured on")
    split: str = column("Split of the instance's room")
    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    room_id: str = column("Physical room; intervals are over these", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    category: str = column("What the instance is")
    is_held_out_category: bool = column("No instance of the category was learned from")
    candidate_count: int = column("Candidates that were scored", minimum=1)
    chosen_asset_id: str = column("Asset that it chose", pattern=HASH)
    is_chosen_own: bool = column("The choice has the scanned model's own mesh, or is its crop")
    is_fallback: bool = column("The method lacked what it needs, and the geometric score stood in")
    truth_rank: int | None = column("Place of the true candidate; null where none of them is", minimum=1)
    truth_rank_without_own: int | None = column(
        "The same where candidates with the scanned model's own mesh, and its crop, do not compete: place of the best of the others; null "
        "where there are none",
        minimum=1,
    )
    chamfer_m: float | None = column("Half of both mean nearest distances of the choice and the scanned model", unit="m", minimum=0)
    chamfer_m2: float | None = column("Half of both mean squared nearest distances", unit="m2", minimum=0)
    ecd_m: float | None = column("As chamfer_m, with what normals and curvature differ by", unit="m", minimum=0)
    box_iou: float | None = column("Intersection over union of boxes along the axes of the world", minimum=0, maximum=1)
    oriented_iou: float | None = column("Intersection over union of boxes turned about +Z", minimum=0, maximum=1)
    color_kl: float | None = column("Divergence of the choice's colors from those of the scanned model, in nats", minimum=0)
    best_chamfer_m: float | None = column("Least chamfer_m of all candidates", unit="m", minimum=0)
    best_chamfer_m2: float | None = column("Least chamfer_m2 of all candidates", unit="m2", minimum=0)
    best_ecd_m: float | None = column("Least ecd_m of all candidates", unit="m", minimum=0)
    best_box_iou: float | None = column("Largest box_iou of all candidates", minimum=0, maximum=1)
    best_oriented_iou: float | None = column("Largest oriented_iou of all candidates", minimum=0, maximum=1)
    best_color_kl: float | None = column("Least color_kl of all candidates", minimum=0)
    seconds: float | None = column("Time that scoring the instance's candidates took", unit="s", minimum=0, volatile=True)
