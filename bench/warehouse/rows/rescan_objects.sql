-- Those that both scans are sure to have as objects, by their number, are said to be the same, and the others to be added.
SELECT
    scene_id,
    room_id || '_00' AS reference_scene_id,
    number,
    CASE WHEN place NOT BETWEEN 7 AND 19 THEN 'added' WHEN u(object, 'moved') < 0.2 THEN 'moved' ELSE 'unchanged' END AS change,
    instance_id,
    CASE WHEN place BETWEEN 7 AND 19 THEN instance_id END AS reference_instance_id,
    category,
    CASE WHEN place BETWEEN 7 AND 19 THEN [u(object, 'moved'), 0.0, 0.0] END AS shift,
    CASE WHEN place BETWEEN 7 AND 19 THEN u(object, 'moved') END AS distance_m,
    CASE WHEN place BETWEEN 7 AND 19 THEN 0.0 END AS turn_radians,
    CASE WHEN place NOT BETWEEN 7 AND 19 THEN 1.0 END AS seen_share
FROM objects_now
WHERE is_rescan
