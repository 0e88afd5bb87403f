-- The floor, four walls and the ceiling; the scan shows most of each.
SELECT
    scene_id,
    face AS surface,
    digest('texture', scene * 10 + number) || '.jpg' AS texture_blob,
    [0.0, 0.0, 0.0] AS origin,
    [1.0, 0.0, 0.0] AS u_axis,
    CASE WHEN starts_with(face, 'wall') THEN [0.0, 0.0, 1.0] ELSE [0.0, 1.0, 0.0] END AS v_axis,
    room_width AS width_m,
    CASE WHEN starts_with(face, 'wall') THEN 2.6 ELSE room_depth END AS height_m,
    [room_width / 256, CASE WHEN starts_with(face, 'wall') THEN 2.6 ELSE room_depth END / 256] AS texel_m,
    round(0.4 + 0.6 * u(scene * 10 + number, 'seen'), 3) AS seen_share,
    [60 + below(scene, 'face red', 150), 50 + below(scene, 'face green', 150), 40 + below(scene, 'face blue', 150)] AS color
FROM (
    SELECT *, ['floor', 'wall_00', 'wall_01', 'wall_02', 'wall_03', 'ceiling'][1 + number] AS face
    FROM (SELECT *, unnest(range(6)) AS number FROM scenes_now)
)
