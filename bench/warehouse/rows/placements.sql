-- The first annotator's choice where there is one and its batch was accepted, else the best candidate.
SELECT
    scene_id,
    instance_id,
    asset_of(object, slot, library.asset_id) AS asset_id,
    CASE WHEN is_chosen THEN 'annotation' ELSE 'selection' END AS origin,
    CASE WHEN is_chosen THEN 'annotator-1' END AS annotator,
    CASE WHEN is_chosen THEN 'same_box' END AS annotation_match,
    [1.0, 1.0, round(0.8 + 0.4 * u(object, 'scale'), 2)] AS scale,
    pose(yaw, x, y, 0.0) AS proposed_pose,
    pose(yaw, x + shift_x, y, 0.0) AS optimized_pose,
    CASE WHEN u(object, 'refused') >= 0.001 THEN pose(yaw, x + shift_x, y, 0.0) END AS settled_pose,
    abs(shift_x) AS displacement_m,
    0.0 AS lift_m,
    12 AS collider_pieces,
    240 AS collider_faces,
    CASE WHEN u(object, 'early') < 0.02 THEN 0.05 ELSE 0.004 END AS collider_early_share,
    0.001 AS collider_miss_share,
    NULL AS collider_blob,
    0.0 AS collider_cut_share,
    0.0 AS collider_distance_m,
    0.0 AS fidelity_loss,
    'default' AS method,
    CASE WHEN u(object, 'remains') < 0.01 THEN 'nothing carries it' END AS remains
FROM (
    SELECT
        *,
        1 + (shift + placed_rank - 1) % 10 AS slot,
        library_start + below(object * 16 + slot, 'asset', library_count) AS library_index
    FROM (
        SELECT
            *,
            is_annotated(scene) AND wrong_of(scene) = 0 AND answer_of(object, 1) IS NOT NULL AS is_chosen,
            CASE WHEN is_chosen THEN answer_of(object, 1) ELSE 1 END AS placed_rank,
            CASE WHEN u(object, 'moved') < 0.3 THEN round(0.1 * u(object, 'move'), 3) ELSE 0.0 END AS shift_x
        FROM objects_now
    )
) AS placed
LEFT JOIN library ON library.library_index = placed.library_index
