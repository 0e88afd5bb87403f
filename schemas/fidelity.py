"""Rows of the fidelity stage: what a replica keeps of its scan, and what it adds."""

from __future__ import annotations

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record


@record("fidelity", key=("scene_id", "instance_id"), stage="fidelity")
class Fidelity:
    """How near the asset of one object comes to what was scanned of it. Only surface that the cameras could see counts of the asset."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance, an object: not a wall, floor or ceiling", pattern=INSTANCE_PATTERN)
    is_placed: bool = column("An asset stands for it; without one its completeness and F-scores are 0")
    scan_area_m2: float = column("Area of the object's scanned surface", unit="m2", minimum=0)
    visible_area_m2: float | None = column(
        "Area of the asset's surface that the scan's cameras could see; missing without an asset", unit="m2", minimum=0
    )
    completeness_2cm: float = column("Share of the object's scanned surface within 2 cm of its asset", minimum=0, maximum=1)
    completeness_5cm: float = column("The same within 5 cm", minimum=0, maximum=1)
    completeness_10cm: float = column("The same within 10 cm", minimum=0, maximum=1)
    accuracy_2cm: float | None = column(
        "Share of the asset's visible surface within 2 cm of the object's scanned surface; missing when none is visible",
        minimum=0,
        maximum=1,
    )
    accuracy_5cm: float | None = column("The same within 5 cm", minimum=0, maximum=1)
    accuracy_10cm: float | None = column("The same within 10 cm", minimum=0, maximum=1)
    f_2cm: float | None = column(
        "Harmonic mean of accuracy and completeness at 2 cm; 0 without an asset, missing when nothing of it is visible",
        minimum=0,
        maximum=1,
    )
    f_5cm: float | None = column("The same at 5 cm", minimum=0, maximum=1)
    f_10cm: float | None = column("The same at 10 cm", minimum=0, maximum=1)
    seen_empty_share: float | None = column(
        "Share of the asset's visible surface where the scan saw nothing: farther than the margin (5 cm by default) from all that was "
        "scanned, and a camera saw scanned surface at least that far behind it; missing when none is visible",
        minimum=0,
        maximum=1,
    )
    in_others_share: float | None = column(
        "Share of the asset's visible surface within 5 cm of another object's scanned surface and not of its own; missing when none is "
        "visible",
        minimum=0,
        maximum=1,
    )
    color_difference: float | None = column(
        "Mean CIEDE2000 color difference of scan and replica over the pixels that show the asset within 10 cm of the scan's depth; missing "
        "when these are too few",
        minimum=0,
    )


@record("scene_fidelity", key=("scene_id",), stage="fidelity")
class SceneFidelity:
    """How near a replica comes to its scan. The shell are floor, walls and ceiling; replicas have a ceiling where it is asked for."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    cameras: str = column(
        "Where the cameras came from: poses of the scan's frames, or places chosen in its free space", values=("frames", "virtual")
    )
    camera_count: int = column("Cameras that decided what could be seen", minimum=1)
    object_count: int = column("Objects of the scan", minimum=0)
    placed_count: int = column("Objects for which an asset stands", minimum=0)
    scan_area_m2: float = column("Area of the whole scanned surface", unit="m2", minimum=0)
    object_area_m2: float = column("Area of the scanned surface of all objects", unit="m2", minimum=0)
    shell_area_m2: float = column("Area of the scanned surface of floor, walls and ceiling", unit="m2", minimum=0)
    unlabeled_area_m2: float = column("Area of the scanned surface farther than 1 cm from every instance's", unit="m2", minimum=0)
    object_completeness_2cm: float | None = column(
        "Share of all objects' scanned surface within 2 cm of any asset; missing without objects", minimum=0, maximum=1
    )
    object_completeness_5cm: float | None = column("The same within 5 cm", minimum=0, maximum=1)
    object_completeness_10cm: float | None = column("The same within 10 cm", minimum=0, maximum=1)
    object_accuracy_2cm: float | None = column(
        "Share of all assets' visible surface within 2 cm of any object's scanned surface; missing when none is visible",
        minimum=0,
        maximum=1,
    )
    object_accuracy_5cm: float | None = column("The same within 5 cm", minimum=0, maximum=1)
    object_accuracy_10cm: float | None = column("The same within 10 cm", minimum=0, maximum=1)
    object_f_2cm: float | None = column(
        "Harmonic mean of the two at 2 cm; 0 when no object has an asset, missing without objects or when no asset is visible",
        minimum=0,
        maximum=1,
    )
    object_f_5cm: float | None = column("The same at 5 cm", minimum=0, maximum=1)
    object_f_10cm: float | None = column("The same at 10 cm", minimum=0, maximum=1)
    shell_completeness_2cm: float | None = column(
        "Share of the scanned surface of floor, walls and ceiling within 2 cm of those of the replica; missing when none was scanned",
        minimum=0,
        maximum=1,
    )
    shell_completeness_5cm: float | None = column("The same within 5 cm", minimum=0, maximum=1)
    shell_completeness_10cm: float | None = column("The same within 10 cm", minimum=0, maximum=1)
    shell_accuracy_2cm: float | None = column(
        "Share of the visible surface of the replica's floor, walls and ceiling, where it has one, within 2 cm of those that were "
        "scanned; missing without a room, or when none is visible or was scanned",
        minimum=0,
        maximum=1,
    )
    shell_accuracy_5cm: float | None = column("The same within 5 cm", minimum=0, maximum=1)
    shell_accuracy_10cm: float | None = column("The same within 10 cm", minimum=0, maximum=1)
    shell_f_2cm: float | None = column("Harmonic mean of the two at 2 cm; missing where either is", minimum=0, maximum=1)
    shell_f_5cm: float | None = column("The same at 5 cm", minimum=0, maximum=1)
    shell_f_10cm: float | None = column("The same at 10 cm", minimum=0, maximum=1)
    unexplained_area_m2: float = column(
        "Area of the scanned surface of objects, and of unlabeled surface, farther than 5 cm from everything in the replica",
        unit="m2",
        minimum=0,
    )
    unexplained_share: float | None = column(
        "That area over the area of objects and of unlabeled surface; missing when there is none", minimum=0, maximum=1
    )
    seen_empty_share: float | None = column(
        "Share of all assets' visible surface where the scan saw nothing; missing when none is visible", minimum=0, maximum=1
    )
    in_others_share: float | None = column(
        "Share of all assets' visible surface within 5 cm of another object's scanned surface and not of its own; missing when none is "
        "visible",
        minimum=0,
        maximum=1,
    )
    color_difference: float | None = column(
        "Mean CIEDE2000 color difference of renders of scan and replica, over pixels where both show something; missing without such",
        minimum=0,
    )
    structural_similarity: float | None = column(
        "Mean structural similarity (SSIM) of the gray values of these renders, over the same pixels; missing without such",
        minimum=-1,
        maximum=1,
    )
    median_depth_error_m: float | None = column("Median depth difference of these pixels", unit="m", minimum=0)
    mean_depth_error_m: float | None = column("Mean depth difference of these pixels", unit="m", minimum=0)
    both_seen_share: float | None = column(
        "Share of the pixels that show the scan and show the replica, too; missing when none shows the scan", minimum=0, maximum=1
    )
    distances_blob: str = column(
        "Points of the scanned surface in the world frame, binary PLY: x y z float32 [m], distance float32 [m] to the nearest surface of "
        "the replica (infinite where it has none), part uint8 (0 object, 1 floor, wall or ceiling, 2 unlabeled)",
        blob=True,
    )
