-- The best frames of an object are those of its masks.
SELECT
    scene_id,
    instance_id,
    place AS source_id,
    label AS raw_label,
    label AS category,
    CASE label WHEN 'wall' THEN 1 WHEN 'floor' THEN 2 WHEN 'ceiling' THEN 22 ELSE nyu40_id END AS nyu40_id,
    CASE WHEN is_structure THEN label ELSE nyu40_label END AS nyu40_label,
    is_structure,
    'file' AS found_by,
    CAST(NULL AS DOUBLE) AS category_probability,
    CASE WHEN NOT is_structure THEN 0 END AS room_index,
    CASE WHEN is_structure THEN pose(0.0, room_width / 2, room_depth / 2, 0.0) ELSE pose(yaw, x, y, size_z / 2) END AS box_pose,
    CASE WHEN is_structure THEN [room_width, room_depth, 0.1] ELSE [size_x, size_y, size_z] END AS box_size,
    CASE WHEN is_structure THEN room_width * room_depth * 0.1 ELSE volume END AS box_volume_m3,
    200 + CAST(4000 * cbrt(volume) AS BIGINT) AS point_count,
    digest('points', object) || '.ply' AS points_blob,
    digest('mesh', object) || '.glb' AS mesh_blob,
    CASE WHEN NOT is_structure THEN digest('view', object) || '.jpg' END AS view_blob,
    CASE WHEN is_structure THEN [] ELSE list_transform(
        range(3), lambda turn: lpad(CAST((turn * objects + number) * 100 // (3 * objects) AS VARCHAR), 6, '0')
    ) END AS best_frames
FROM (
    SELECT *, CASE WHEN NOT is_structure THEN category WHEN place = 0 THEN 'floor' WHEN place = 1 THEN 'ceiling' ELSE 'wall' END AS label
    FROM shaped_now
)
