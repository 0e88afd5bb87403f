-- Every fortieth scene counts as drawn: what is on its first object.
SELECT
    scene_id,
    digest('drawing model', 0) AS model_id,
    'physcene' AS model_kind,
    instance_id,
    ['desk', 'table', 'cabinet', 'shelf', 'nightstand', 'counter'][1 + below(object, 'large', 6)] AS category,
    [size_x, size_y, size_z] AS box_size,
    pose(yaw, x, y, 0.0) AS frame_pose,
    ['bedroom', 'living room', 'office', 'kitchen', 'bathroom', 'unknown'][1 + below(room, 'kind', 6)] AS room_type,
    0 AS seed,
    scene // 40 AS number,
    NULL AS based_on,
    NULL AS based_on_instance,
    least(3, objects - 1) AS object_count,
    0 AS colliding_count,
    0 AS off_support_count,
    CASE WHEN objects > 1 THEN 1.0 END AS stable_share,
    2.0 AS seconds
FROM objects_now
WHERE scene % 40 = 5 AND number = 0
