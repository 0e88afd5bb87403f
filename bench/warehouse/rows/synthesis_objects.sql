-- The three objects after the first one of a drawn scene.
SELECT
    scene_id,
    instance_id,
    ['mug', 'book', 'lamp', 'box', 'bottle', 'monitor', 'keyboard', 'plant'][1 + below(object, 'small', 8)] AS category,
    [0.4 * u(object, 'ahead') - 0.2, 0.8 * u(object, 'left') - 0.4, 0.75 + size_z / 2] AS box_center,
    [size_x, size_y, size_z] AS box_size,
    2 * pi() * u(object, 'turn') - pi() AS yaw_radians,
    FALSE AS is_colliding,
    FALSE AS is_off_support,
    TRUE AS is_stable
FROM objects_now
WHERE scene % 40 = 5 AND number BETWEEN 1 AND 3
