SELECT
    scene_id,
    instance_id,
    rank,
    slot,
    asset_of(object, slot, library.asset_id) AS asset_id,
    round(0.95 - 0.2 * u(object, 'fit') - 0.05 * rank, 3) AS score,
    round(0.002 + 0.01 * rank * u(object * 16 + rank, 'chamfer'), 4) AS chamfer_m,
    round(1 - 0.05 * rank * u(object * 16 + rank, 'coverage'), 3) AS coverage,
    round(1 - 0.06 * rank * u(object * 16 + rank, 'overlap'), 3) AS box_iou,
    round(u(object * 16 + rank, 'color'), 3) AS color_similarity,
    pose(yaw + radians(90 * below(object * 16 + rank, 'turn', 4)), x, y, 0.0) AS pose,
    [1.0, 1.0, round(0.8 + 0.4 * u(object * 16 + rank, 'scale'), 2)] AS scale,
    'geometric' AS provider,
    '1' AS provider_version
FROM ranks_now
LEFT JOIN library ON library.library_index = ranks_now.library_index
