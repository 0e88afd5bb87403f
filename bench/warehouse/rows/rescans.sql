-- Each rescan lies in the frame of the scan before it: their rooms are made alike.
SELECT
    scene_id,
    room_id || '_00' AS reference_scene_id,
    room_id,
    'registered' AS outcome,
    NULL AS problem,
    pose(0.0, 0.0, 0.0, 0.0) AS pose,
    0.8 + 0.2 * u(scene, 'walls') AS wall_share,
    0.6 + 0.4 * u(scene, 'furniture') AS object_share,
    0.0 AS conflict_share
FROM scenes_now
WHERE is_rescan
