"""What the report's tables show of the views: caption, and per column its header and how it is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pyarrow as pa

from tasks.stats.grids import (
    Format,
    Grid,
    as_count,
    as_number,
    as_percent,
    as_share,
    as_size,
    as_text,
    as_yes,
    grid,
    place,
)


def report_grids(answers: Mapping[str, pa.Table], totals: Mapping[str, int], stages: Sequence[str]) -> dict[str, Grid]:
    """The report's tables over all scenes, by view.

    Args:
        answers: The first rows of every view of `GRIDS`.
        totals: How many rows a view has, where it has more.
        stages: In the order of the data path.
    """
    timing = sorted(answers["stage_timing"].to_pylist(), key=lambda row: place(row["stage"], stages))
    rows = {**answers, "stage_timing": pa.Table.from_pylist(timing, schema=answers["stage_timing"].schema)}
    return {view: grid(caption, view, rows[view], shown, totals.get(view)) for view, (caption, shown) in GRIDS.items()}


GRIDS: Mapping[str, tuple[str, tuple[tuple[str, str, Format], ...]]] = {
    "stage_timing": (
        "Time per stage",
        (
            ("stage", "Stage", as_text),
            ("scenes", "Scenes", as_count),
            ("runs", "Runs", as_count),
            ("total_seconds", "Total [s]", as_number),
            ("median_seconds", "Median [s]", as_number),
            ("p95_seconds", "95th percentile [s]", as_number),
            ("seconds_per_object", "Per object [s]", as_number),
            ("peak_memory_mb", "Peak memory [MB]", as_number),
        ),
    ),
    "dataset_comparison": (
        "Datasets side by side",
        (
            ("dataset", "Dataset", as_text),
            ("scenes", "Scenes", as_count),
            ("objects", "Objects", as_count),
            ("median_objects_per_scene", "Per scene, median", as_number),
            ("categories", "Categories known", as_count),
            ("known_share", "Objects of these", as_share),
            ("median_box_volume_m3", "Box, median [m\u00b3]", as_number),
            ("placed_share", "Placed", as_share),
            ("assets", "Placed assets", as_count),
            ("mean_displacement_m", "Moved, mean [m]", as_number),
            ("free_objects", "Free, certified", as_count),
            ("stable_5cm_share", "Within 5 cm and 5\u00b0", as_share),
        ),
    ),
    "annotation_timing": (
        "Minutes per object: the paper's annotation, people's here, and computation",
        (
            ("reading", "Whose", as_text),
            ("scenes", "Scenes", as_count),
            ("objects", "Objects", as_count),
            ("minutes", "Minutes", as_number),
            ("minutes_per_object", "Per object", as_number),
            ("minutes_per_39_objects", "Per 39 objects", as_number),
            ("times_paper", "Times the paper's", as_number),
        ),
    ),
    "annotation_agreement": (
        "Annotators and the selection",
        (
            ("annotator", "Annotator", as_text),
            ("answers", "Answers", as_count),
            ("none_fits", "None fits", as_count),
            ("same_as_selection", "As selected", as_count),
            ("agreement", "Agreement", as_share),
        ),
    ),
    "annotator_agreement": (
        "Annotators among themselves",
        (
            ("annotator_a", "Annotator", as_text),
            ("annotator_b", "and", as_text),
            ("instances", "Objects of both", as_count),
            ("agreement", "Agreement", as_share),
            ("chance_agreement", "By chance", as_share),
            ("cohens_kappa", "Cohen's kappa", as_number),
        ),
    ),
    "quality_history": (
        "Quality control of annotation batches",
        (
            ("batch_id", "Batch", as_text),
            ("answers", "Answers", as_count),
            ("round", "Review", as_count),
            ("reviewer", "By", as_text),
            ("sampled", "Sampled", as_count),
            ("wrong", "Wrong", as_count),
            ("wrong_low", "from", as_share),
            ("wrong_high", "to", as_share),
            ("verdict", "Verdict", as_text),
        ),
    ),
    "failures": (
        "Failed stages",
        (
            ("scene_id", "Scene", as_text),
            ("stage", "Stage", as_text),
            ("error_kind", "Kind", as_text),
            ("error", "What and what to do", as_text),
        ),
    ),
    "broken_rules": (
        "Broken export rules",
        (
            ("format", "Format", as_text),
            ("rule", "Rule", as_text),
            ("scene_id", "Scene", as_text),
            ("message", "What is wrong", as_text),
        ),
    ),
    "degradation_counts": (
        "Degradations",
        (
            ("stage", "Stage", as_text),
            ("degradation", "What was left out or replaced", as_text),
            ("times", "Times", as_count),
            ("scenes", "Scenes", as_count),
        ),
    ),
    "fallback_counts": (
        "Providers and fallbacks",
        (
            ("stage", "Stage", as_text),
            ("provider", "Provider", as_text),
            ("provider_version", "Version", as_text),
            ("answers", "Answers", as_count),
            ("fallbacks", "As a fallback", as_count),
        ),
    ),
    "selection_quality": (
        "Fit of the selected candidates",
        (
            ("category", "Category", as_text),
            ("objects", "Objects", as_count),
            ("median_score", "Median score", as_number),
            ("lowest_score", "Lowest", as_number),
            ("median_chamfer_m", "Chamfer distance [m]", as_number),
            ("median_coverage", "Coverage", as_percent),
            ("median_box_iou", "Box IoU", as_number),
        ),
    ),
    "scene_certificates": (
        "Plausibility of scenes, the worst first",
        (
            ("scene_id", "Scene", as_text),
            ("method", "Method", as_text),
            ("engine", "Engine", as_text),
            ("deep_pairs", "Deep pairs", as_count),
            ("free", "Free", as_count),
            ("unstable_1cm", "Beyond 1 cm", as_count),
            ("unstable_5cm", "Beyond 5 cm or 5\u00b0", as_count),
            ("uncertified", "Uncertified", as_count),
            ("lost_supports", "Lost supports", as_count),
            ("implausible_densities", "Odd densities", as_count),
            ("remains", "Remains", as_count),
            ("is_plausible", "Plausible", as_yes),
        ),
    ),
    "stability": (
        "Left alone under gravity, the least stable scenes first",
        (
            ("scene_id", "Scene", as_text),
            ("engine", "Engine", as_text),
            ("engine_version", "Version", as_text),
            ("objects", "Objects", as_count),
            ("fixed", "Fixed", as_count),
            ("free", "Free", as_count),
            ("stable_1cm_share", "Within 1 cm", as_share),
            ("stable_5cm_share", "Within 5 cm and 5\u00b0", as_share),
            ("refused", "Not simulated", as_count),
            ("uncertified", "Uncertified", as_count),
            ("worst_displacement_m", "Moves most [m]", as_number),
            ("worst_tilt_degrees", "Tilts most [\u00b0]", as_number),
        ),
    ),
    "unstable_objects": (
        "Objects that do not stay",
        (
            ("scene_id", "Scene", as_text),
            ("instance_id", "Instance", as_text),
            ("category", "Category", as_text),
            ("engine", "Engine", as_text),
            ("support", "Carried by", as_text),
            ("displacement_m", "Moves [m]", as_number),
            ("tilt_degrees", "Tilts [\u00b0]", as_number),
            ("start_penetration_m", "Starts at depth [m]", as_number),
            ("fails_5cm", "Fails at 5 cm or 5\u00b0", as_yes),
            ("problem", "Could not be simulated", as_text),
        ),
    ),
    "optimization_remains": (
        "What the optimization could not put right",
        (
            ("scene_id", "Scene", as_text),
            ("instance_id", "Instance", as_text),
            ("category", "Category", as_text),
            ("remains", "What remains", as_text),
        ),
    ),
    "support_counts": (
        "What carries the objects",
        (
            ("scene_id", "Scene", as_text),
            ("on_floor", "Floor", as_count),
            ("on_objects", "On others", as_count),
            ("inside_objects", "Inside others", as_count),
            ("on_walls", "Walls", as_count),
            ("on_ceiling", "Ceiling", as_count),
            ("unsupported", "Nothing", as_count),
            ("fixed", "Fixed", as_count),
            ("lost", "Lost", as_count),
        ),
    ),
    "density_check": (
        "Densities",
        (
            ("category", "Category", as_text),
            ("objects", "Objects", as_count),
            ("implausible", "Implausible", as_count),
            ("without_verdict", "No verdict", as_count),
            ("least_density_kg_m3", "Least [kg/m\u00b3]", as_number),
            ("median_density_kg_m3", "Median [kg/m\u00b3]", as_number),
            ("greatest_density_kg_m3", "Greatest [kg/m\u00b3]", as_number),
            ("allowed_from_kg_m3", "Allowed from", as_number),
            ("allowed_to_kg_m3", "Allowed to", as_number),
        ),
    ),
    "navigability": (
        "Navigable floor, the least first",
        (
            ("scene_id", "Scene", as_text),
            ("agent", "Agent", as_text),
            ("area_m2", "Free for its center [m\u00b2]", as_number),
            ("navigable_share", "Of the floor", as_percent),
            ("island_count", "Islands", as_count),
            ("largest_island_share", "Largest island", as_percent),
            ("episodes", "Episodes", as_count),
            ("targets", "Targets", as_count),
            ("unreachable_targets", "No episode possible", as_count),
        ),
    ),
    "navigation_metrics": (
        "How well policies navigate",
        (
            ("policy", "Policy", as_text),
            ("run_name", "Run", as_text),
            ("agent", "Agent", as_text),
            ("split", "Split", as_text),
            ("success_distance_m", "Success below [m]", as_number),
            ("n", "Trajectories", as_count),
            ("sr", "SR", as_share),
            ("sr_low", "from", as_share),
            ("sr_high", "to", as_share),
            ("spl", "SPL", as_number),
            ("sel", "SEL", as_number),
            ("el", "EL", as_number),
            ("curvature_turning_angle", "Curvature [rad/m]", as_number),
        ),
    ),
    "unreachable_objects": (
        "Objects that no episode could be made for",
        (
            ("scene_id", "Scene", as_text),
            ("instance_id", "Instance", as_text),
            ("category", "Category", as_text),
            ("reason", "Why", as_text),
        ),
    ),
    "export_verdicts": (
        "Exports",
        (
            ("scene_id", "Scene", as_text),
            ("format", "Format", as_text),
            ("files", "Files", as_count),
            ("size_bytes", "Size", as_size),
            ("rules", "Rules", as_count),
            ("broken_rules", "Broken", as_count),
            ("passed", "Passes", as_yes),
        ),
    ),
    "license_counts": (
        "Licenses",
        (
            ("material", "Of", as_text),
            ("license", "License", as_text),
            ("items", "Items", as_count),
            ("uses", "Uses", as_count),
            ("scenes", "Scenes", as_count),
        ),
    ),
    "attributions": (
        "Where placed assets come from",
        (
            ("license", "License", as_text),
            ("author", "Author", as_text),
            ("provider", "Provider", as_text),
            ("source", "Source", as_text),
            ("uses", "Uses", as_count),
        ),
    ),
}
