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


_COLUMNS: Mapping[str, tuple[str, Format]] = {
    "stage": ("Stage", as_text),
    "scenes": ("Scenes", as_count),
    "runs": ("Runs", as_count),
    "total_seconds": ("Total [s]", as_number),
    "median_seconds": ("Median [s]", as_number),
    "p95_seconds": ("95th percentile [s]", as_number),
    "seconds_per_object": ("Per object [s]", as_number),
    "peak_memory_mb": ("Peak memory [MB]", as_number),
    "dataset": ("Dataset", as_text),
    "objects": ("Objects", as_count),
    "median_objects_per_scene": ("Per scene, median", as_number),
    "categories": ("Categories known", as_count),
    "known_share": ("Objects of these", as_share),
    "median_box_volume_m3": ("Box, median [m\u00b3]", as_number),
    "placed_share": ("Placed", as_share),
    "assets": ("Placed assets", as_count),
    "mean_displacement_m": ("Moved, mean [m]", as_number),
    "free_objects": ("Free, certified", as_count),
    "stable_5cm_share": ("Within 5 cm and 5\u00b0", as_share),
    "stable_nudged_share": ("After nudges", as_share),
    "reading": ("Whose", as_text),
    "minutes": ("Minutes", as_number),
    "minutes_per_object": ("Per object", as_number),
    "minutes_per_39_objects": ("Per 39 objects", as_number),
    "times_paper": ("Times the paper's", as_number),
    "annotator": ("Annotator", as_text),
    "answers": ("Answers", as_count),
    "none_fits": ("None fits", as_count),
    "same_as_selection": ("As selected", as_count),
    "agreement": ("Agreement", as_share),
    "annotator_a": ("Annotator", as_text),
    "annotator_b": ("and", as_text),
    "instances": ("Objects of both", as_count),
    "chance_agreement": ("By chance", as_share),
    "cohens_kappa": ("Cohen's kappa", as_number),
    "batch_id": ("Batch", as_text),
    "round": ("Review", as_count),
    "reviewer": ("By", as_text),
    "sampled": ("Sampled", as_count),
    "wrong": ("Wrong", as_count),
    "wrong_low": ("from", as_share),
    "wrong_high": ("to", as_share),
    "verdict": ("Verdict", as_text),
    "scene_id": ("Scene", as_text),
    "error_kind": ("Kind", as_text),
    "error": ("What and what to do", as_text),
    "format": ("Format", as_text),
    "rule": ("Rule", as_text),
    "message": ("What is wrong", as_text),
    "degradation": ("What was left out or replaced", as_text),
    "times": ("Times", as_count),
    "provider": ("Provider", as_text),
    "provider_version": ("Version", as_text),
    "fallbacks": ("As a fallback", as_count),
    "category": ("Category", as_text),
    "median_score": ("Median score", as_number),
    "lowest_score": ("Lowest", as_number),
    "median_chamfer_m": ("Chamfer distance [m]", as_number),
    "median_coverage": ("Coverage", as_percent),
    "median_box_iou": ("Box IoU", as_number),
    "method": ("Method", as_text),
    "engine": ("Engine", as_text),
    "deep_pairs": ("Deep pairs", as_count),
    "free": ("Free", as_count),
    "unstable_1cm": ("Beyond 1 cm or 5\u00b0", as_count),
    "unstable_5cm": ("Beyond 5 cm or 5\u00b0", as_count),
    "nudged_displacement_m": ("After a nudge [m]", as_number),
    "nudged_tilt_degrees": ("Tilts after it [\u00b0]", as_number),
    "unstable_nudged": ("Moved by a nudge", as_count),
    "uncertified": ("Uncertified", as_count),
    "lost_supports": ("Lost supports", as_count),
    "implausible_densities": ("Odd densities", as_count),
    "remains": ("Remains", as_count),
    "is_plausible": ("Plausible", as_yes),
    "engine_version": ("Version", as_text),
    "fixed": ("Fixed", as_count),
    "stable_1cm_share": ("Within 1 cm and 5\u00b0", as_share),
    "refused": ("Not simulated", as_count),
    "worst_displacement_m": ("Moves most [m]", as_number),
    "worst_tilt_degrees": ("Tilts most [\u00b0]", as_number),
    "instance_id": ("Instance", as_text),
    "support": ("Carried by", as_text),
    "displacement_m": ("Moves [m]", as_number),
    "tilt_degrees": ("Tilts [\u00b0]", as_number),
    "start_penetration_m": ("Starts at depth [m]", as_number),
    "fails_5cm": ("Fails at 5 cm or 5\u00b0", as_yes),
    "problem": ("Could not be simulated", as_text),
    "optimization_remains.remains": ("What remains", as_text),
    "on_floor": ("Floor", as_count),
    "on_objects": ("On others", as_count),
    "inside_objects": ("Inside others", as_count),
    "on_walls": ("Walls", as_count),
    "on_ceiling": ("Ceiling", as_count),
    "unsupported": ("Nothing", as_count),
    "lost": ("Lost", as_count),
    "implausible": ("Implausible", as_count),
    "without_verdict": ("No verdict", as_count),
    "least_density_kg_m3": ("Least [kg/m\u00b3]", as_number),
    "median_density_kg_m3": ("Median [kg/m\u00b3]", as_number),
    "greatest_density_kg_m3": ("Greatest [kg/m\u00b3]", as_number),
    "allowed_from_kg_m3": ("Allowed from", as_number),
    "allowed_to_kg_m3": ("Allowed to", as_number),
    "agent": ("Agent", as_text),
    "area_m2": ("Free for its center [m\u00b2]", as_number),
    "navigable_share": ("Of the floor", as_percent),
    "island_count": ("Islands", as_count),
    "largest_island_share": ("Largest island", as_percent),
    "episodes": ("Episodes", as_count),
    "targets": ("Targets", as_count),
    "unreachable_targets": ("No episode possible", as_count),
    "policy": ("Policy", as_text),
    "run_name": ("Run", as_text),
    "split": ("Split", as_text),
    "success_distance_m": ("Success below [m]", as_number),
    "n": ("Trajectories", as_count),
    "selection_methods.instances": ("Objects", as_count),
    "top_1": ("Top-1", as_share),
    "top_1_low": ("from", as_share),
    "top_1_high": ("to", as_share),
    "top_1_without_own": ("Top-1 without own mesh or crop", as_share),
    "top_1_without_own_low": ("from", as_share),
    "top_1_without_own_high": ("to", as_share),
    "top_5": ("Top-5", as_share),
    "top_5_low": ("from", as_share),
    "top_5_high": ("to", as_share),
    "chamfer_m": ("CD [m]", as_number),
    "chamfer_m_low": ("from", as_number),
    "chamfer_m_high": ("to", as_number),
    "ecd_m": ("ECD [m]", as_number),
    "ecd_m_low": ("from", as_number),
    "ecd_m_high": ("to", as_number),
    "box_iou": ("Box IoU", as_number),
    "box_iou_low": ("from", as_number),
    "box_iou_high": ("to", as_number),
    "color_kl": ("Color KL", as_number),
    "color_kl_low": ("from", as_number),
    "color_kl_high": ("to", as_number),
    "regret_chamfer_m": ("Regret in CD [m]", as_number),
    "regret_chamfer_m_low": ("from", as_number),
    "regret_chamfer_m_high": ("to", as_number),
    "milliseconds": ("Per object [ms]", as_number),
    "sr": ("SR", as_share),
    "sr_low": ("from", as_share),
    "sr_high": ("to", as_share),
    "spl": ("SPL", as_number),
    "sel": ("SEL", as_number),
    "el": ("EL", as_number),
    "curvature_turning_angle": ("Curvature [rad/m]", as_number),
    "reason": ("Why", as_text),
    "files": ("Files", as_count),
    "size_bytes": ("Size", as_size),
    "rules": ("Rules", as_count),
    "broken_rules": ("Broken", as_count),
    "passed": ("Passes", as_yes),
    "material": ("Of", as_text),
    "license": ("License", as_text),
    "items": ("Items", as_count),
    "uses": ("Uses", as_count),
    "author": ("Author", as_text),
    "source": ("Source", as_text),
    "name": ("Asset", as_text),
    "early_share": ("Stop early", as_percent),
    "miss_share": ("Miss", as_percent),
    "pieces": ("Pieces", as_count),
    "faces": ("Faces", as_count),
    "object_count": ("Objects", as_count),
    "placed_count": ("Placed", as_count),
    "object_f_2cm": ("F at 2 cm", as_number),
    "object_f_5cm": ("F at 5 cm", as_number),
    "object_f_10cm": ("F at 10 cm", as_number),
    "object_completeness_5cm": ("Completeness", as_share),
    "object_accuracy_5cm": ("Accuracy", as_share),
    "shell_f_5cm": ("F of floor and walls", as_number),
    "unexplained_share": ("Unexplained", as_share),
    "seen_empty_share": ("In seen-empty space", as_share),
    "in_others_share": ("In others", as_share),
    "color_difference": ("CIEDE2000", as_number),
    "structural_similarity": ("SSIM", as_number),
    "median_depth_error_m": ("Depth error, median [m]", as_number),
    "placed": ("Placed", as_count),
    "unseen": ("Hidden", as_count),
    "mean_completeness_5cm": ("Completeness", as_share),
    "mean_accuracy_5cm": ("Accuracy", as_share),
    "mean_f_2cm": ("F at 2 cm", as_number),
    "mean_f_5cm": ("F at 5 cm", as_number),
    "mean_f_10cm": ("F at 10 cm", as_number),
    "least_f_5cm": ("Least at 5 cm", as_number),
    "mean_seen_empty_share": ("In seen-empty space", as_share),
    "mean_in_others_share": ("In others", as_share),
    "mean_color_difference": ("CIEDE2000", as_number),
}
"""Header of a column and how it is written, by its name: the same in every view, but for those that are named with their view."""

_VIEWS: Mapping[str, tuple[str, str]] = {
    "stage_timing": (
        "Time per stage",
        "stage scenes runs total_seconds median_seconds p95_seconds seconds_per_object peak_memory_mb",
    ),
    "dataset_comparison": (
        "Datasets side by side",
        "dataset scenes objects median_objects_per_scene categories known_share median_box_volume_m3 placed_share assets "
        "mean_displacement_m free_objects stable_5cm_share",
    ),
    "annotation_timing": (
        "Minutes per object: the paper's annotation, people's here, and computation",
        "reading scenes objects minutes minutes_per_object minutes_per_39_objects times_paper",
    ),
    "annotation_agreement": (
        "Annotators and the selection",
        "annotator answers none_fits same_as_selection agreement",
    ),
    "annotator_agreement": (
        "Annotators among themselves",
        "annotator_a annotator_b instances agreement chance_agreement cohens_kappa",
    ),
    "quality_history": (
        "Quality control of annotation batches",
        "batch_id answers round reviewer sampled wrong wrong_low wrong_high verdict",
    ),
    "failures": (
        "Failed stages",
        "scene_id stage error_kind error",
    ),
    "broken_rules": (
        "Broken export rules",
        "format rule scene_id message",
    ),
    "degradation_counts": (
        "Degradations",
        "stage degradation times scenes",
    ),
    "fallback_counts": (
        "Providers and fallbacks",
        "stage provider provider_version answers fallbacks",
    ),
    "selection_methods": (
        "Selection methods where the scanned model is known",
        "method dataset split instances top_1 top_1_low top_1_high top_1_without_own top_1_without_own_low top_1_without_own_high top_5 "
        "top_5_low top_5_high chamfer_m chamfer_m_low chamfer_m_high ecd_m ecd_m_low ecd_m_high box_iou box_iou_low box_iou_high color_kl "
        "color_kl_low color_kl_high regret_chamfer_m regret_chamfer_m_low regret_chamfer_m_high milliseconds",
    ),
    "selection_quality": (
        "Fit of the selected candidates",
        "category objects median_score lowest_score median_chamfer_m median_coverage median_box_iou",
    ),
    "scene_certificates": (
        "Plausibility of scenes, the worst first",
        "scene_id method engine deep_pairs free unstable_1cm unstable_5cm unstable_nudged uncertified lost_supports "
        "implausible_densities remains is_plausible",
    ),
    "stability": (
        "Left alone under gravity, the least stable scenes first",
        "scene_id engine engine_version objects fixed free stable_1cm_share stable_5cm_share stable_nudged_share refused uncertified "
        "worst_displacement_m worst_tilt_degrees",
    ),
    "unstable_objects": (
        "Objects that do not stay",
        "scene_id instance_id category engine support displacement_m tilt_degrees nudged_displacement_m nudged_tilt_degrees "
        "start_penetration_m fails_5cm problem",
    ),
    "optimization_remains": (
        "What the optimization could not put right",
        "scene_id instance_id category remains",
    ),
    "support_counts": (
        "What carries the objects",
        "scene_id on_floor on_objects inside_objects on_walls on_ceiling unsupported fixed lost",
    ),
    "collider_fit": (
        "Colliders that fill openings or leave parts out",
        "name category provider objects early_share miss_share pieces faces",
    ),
    "density_check": (
        "Densities",
        "category objects implausible without_verdict least_density_kg_m3 median_density_kg_m3 greatest_density_kg_m3 "
        "allowed_from_kg_m3 allowed_to_kg_m3",
    ),
    "scene_fidelity_overview": (
        "Replicas against their scans, the least alike first",
        "scene_id object_count placed_count object_f_2cm object_f_5cm object_f_10cm object_completeness_5cm object_accuracy_5cm "
        "shell_f_5cm unexplained_share seen_empty_share in_others_share color_difference structural_similarity median_depth_error_m",
    ),
    "fidelity_by_category": (
        "Assets against what was scanned of their objects, means by category",
        "category objects placed unseen mean_f_2cm mean_f_5cm mean_f_10cm least_f_5cm mean_completeness_5cm mean_accuracy_5cm "
        "mean_seen_empty_share mean_in_others_share mean_color_difference",
    ),
    "navigability": (
        "Navigable floor, the least first",
        "scene_id agent area_m2 navigable_share island_count largest_island_share episodes targets unreachable_targets",
    ),
    "navigation_metrics": (
        "How well policies navigate",
        "policy run_name agent split success_distance_m n sr sr_low sr_high spl sel el curvature_turning_angle",
    ),
    "unreachable_objects": (
        "Objects that no episode could be made for",
        "scene_id instance_id category reason",
    ),
    "export_verdicts": (
        "Exports",
        "scene_id format files size_bytes rules broken_rules passed",
    ),
    "license_counts": (
        "Licenses",
        "material license items uses scenes",
    ),
    "attributions": (
        "Where placed assets come from",
        "license author provider source uses",
    ),
}
"""Caption and names of the columns that are shown, by view."""

GRIDS: Mapping[str, tuple[str, tuple[tuple[str, str, Format], ...]]] = {
    view: (caption, tuple((name, *_COLUMNS.get(f"{view}.{name}", _COLUMNS[name])) for name in names.split()))
    for view, (caption, names) in _VIEWS.items()
}
"""What is shown of the views: caption, and name, header and format of every column."""
