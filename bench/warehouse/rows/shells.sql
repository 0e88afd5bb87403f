SELECT
    scene_id,
    ['bedroom', 'living room', 'office', 'kitchen', 'bathroom', 'conference room', 'hallway', 'classroom', 'storage', 'unknown'][
        1 + CAST(floor(10 * u(room, 'kind') ** 1.5) AS BIGINT)
    ] AS room_type,
    [[0.0, 0.0], [room_width, 0.0], [room_width, room_depth], [0.0, room_depth]] AS floor_polygon,
    room_width * room_depth AS floor_area_m2,
    CASE WHEN u(scene, 'floor') < 0.9 THEN 'surface' ELSE 'walls' END AS floor_source,
    [
        [0.0, 0.0, room_width, 0.0], [room_width, 0.0, room_width, room_depth],
        [room_width, room_depth, 0.0, room_depth], [0.0, room_depth, 0.0, 0.0]
    ] AS walls,
    []::DOUBLE[][] AS interior_walls,
    2.3 + round(0.9 * u(room, 'height'), 2) AS height_m,
    CASE WHEN u(scene, 'ceiling') < 0.6 THEN 'ceiling' ELSE 'walls' END AS height_source,
    [60 + below(scene, 'floor red', 150), 50 + below(scene, 'floor green', 150), 40 + below(scene, 'floor blue', 150)] AS floor_color,
    [120 + below(scene, 'wall red', 120), 120 + below(scene, 'wall green', 120), 120 + below(scene, 'wall blue', 120)] AS wall_color
FROM scenes_now
