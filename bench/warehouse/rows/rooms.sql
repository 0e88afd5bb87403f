SELECT
    scene_id,
    0 AS room_index,
    ['bedroom', 'living room', 'office', 'kitchen', 'bathroom', 'conference room', 'hallway', 'classroom', 'storage', 'unknown'][
        1 + CAST(floor(10 * u(room, 'kind') ** 1.5) AS BIGINT)
    ] AS room_type,
    [[0.0, 0.0], [room_width, 0.0], [room_width, room_depth], [0.0, room_depth]] AS floor_polygon,
    room_width * room_depth AS floor_area_m2
FROM scenes_now
