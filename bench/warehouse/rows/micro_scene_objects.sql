-- The three objects after every eighth one; the third is on the second.
SELECT
    scene_id,
    name_of(place - number % 8) AS large_id,
    instance_id,
    ['mug', 'book', 'lamp', 'box', 'bottle', 'monitor', 'keyboard', 'plant'][1 + below(object, 'small', 8)] AS category,
    placed.category AS word,
    asset_of(object, slot, library.asset_id) AS asset_id,
    name_of(place - CASE number % 8 WHEN 3 THEN 1 ELSE number % 8 END) AS parent_id,
    CASE WHEN u(object, 'inside') < 0.2 THEN 'inside' ELSE 'on' END AS relation,
    CASE number % 8 WHEN 3 THEN 2 ELSE 1 END AS depth,
    [0.4 * u(object, 'ahead') - 0.2, 0.8 * u(object, 'left') - 0.4, 0.75 + size_z / 2] AS box_center,
    [size_x, size_y, size_z] AS box_size,
    2 * pi() * u(object, 'turn') - pi() AS yaw_radians,
    0.0 AS tilt_radians
FROM (
    SELECT *, 1 + shift AS slot, library_start + below(object * 16 + slot, 'asset', library_count) AS library_index
    FROM objects_now
    WHERE number % 8 BETWEEN 1 AND 3
) AS placed
LEFT JOIN library ON library.library_index = placed.library_index
