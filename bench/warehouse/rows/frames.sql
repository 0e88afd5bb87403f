SELECT
    scene_id,
    lpad(CAST(frame AS VARCHAR), 6, '0') AS frame_id,
    'color/' || frame || '.jpg' AS color_file,
    'depth/' || frame || '.png' AS depth_file,
    320 AS width,
    240 AS height,
    [286.0, 286.0, 159.5, 119.5] AS intrinsics,
    1000.0 AS depth_scale,
    CASE WHEN u(scene * 100 + frame, 'lost') < 0.98 THEN pose(
        radians(below(scene * 100 + frame, 'yaw', 360)),
        round(room_width * u(scene * 100 + frame, 'x'), 2), round(room_depth * u(scene * 100 + frame, 'y'), 2), 1.5
    ) END AS pose,
    CASE WHEN u(scene * 100 + frame, 'lost') < 0.98 THEN 'file' END AS pose_source
FROM (SELECT *, unnest(range(100)) AS frame FROM scenes_now)
