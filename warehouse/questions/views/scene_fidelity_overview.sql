-- How near does each replica come to its scan?
-- Version 1.
-- F-scores are over the surface of all objects, and of floor, walls and ceiling (shell) apart; completeness and accuracy are at 5 cm.
-- Unexplained is scanned surface of objects or of no instance farther than 5 cm from everything in the replica; seen empty is visible
-- surface of assets where the scan saw nothing. Colors, structure and depth are those of renders from the same cameras.
SELECT
    scene_id,
    cameras,
    camera_count,
    object_count,
    placed_count,
    object_f_2cm,
    object_f_5cm,
    object_f_10cm,
    object_completeness_5cm,
    object_accuracy_5cm,
    shell_f_5cm,
    shell_completeness_5cm,
    shell_accuracy_5cm,
    unexplained_share,
    unlabeled_area_m2 / nullif(scan_area_m2, 0) AS unlabeled_share,
    seen_empty_share,
    in_others_share,
    color_difference,
    structural_similarity,
    median_depth_error_m,
    mean_depth_error_m
FROM scene_fidelity
ORDER BY object_f_5cm NULLS LAST, scene_id
