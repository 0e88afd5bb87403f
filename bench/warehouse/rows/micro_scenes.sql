-- Every eighth object carries the next three.
SELECT
    scene_id,
    instance_id,
    room_id,
    0 AS room_index,
    ['bedroom', 'living room', 'office', 'kitchen', 'bathroom', 'unknown'][1 + below(room, 'kind', 6)] AS room_type,
    ['desk', 'table', 'cabinet', 'shelf', 'nightstand', 'counter'][1 + below(object, 'large', 6)] AS category,
    placed.category AS word,
    asset_of(object, slot, library.asset_id) AS asset_id,
    pose(yaw, x, y, 0.0) AS frame_pose,
    [size_x, size_y, size_z] AS box_size,
    least(3, objects - 1 - number) AS object_count
FROM (
    SELECT *, 1 + shift AS slot, library_start + below(object * 16 + slot, 'asset', library_count) AS library_index
    FROM objects_now
    WHERE number % 8 = 0 AND number + 1 < objects
) AS placed
LEFT JOIN library ON library.library_index = placed.library_index
