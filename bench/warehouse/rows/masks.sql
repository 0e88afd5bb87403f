-- Every object is seen in three frames.
SELECT
    scene_id,
    lpad(CAST(sight * 100 // (3 * objects) AS VARCHAR), 6, '0') AS frame_id,
    name_of(structures + sight % objects) AS instance_id,
    'surface' AS found_by,
    [100, 80, 140, 120] AS pixel_box,
    400 + below(scene * 1000 + sight, 'pixels', 4000) AS pixel_count,
    round(0.5 + 0.5 * u(scene * 1000 + sight, 'visible'), 3) AS visible_share,
    round(10 + 80 * u(scene * 1000 + sight, 'score'), 2) AS score,
    list_transform(range(6), lambda run: below(scene * 10000 + sight * 10 + run, 'run', 40)) AS run_lengths
FROM (SELECT *, unnest(range(3 * objects)) AS sight FROM scenes_now)
