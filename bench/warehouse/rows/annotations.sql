SELECT
    batch_of(scene) AS batch_id,
    scene_id,
    instance_id,
    'annotator-' || annotator AS annotator,
    1 AS revision,
    at_second(scene * 100 + place) AS answered_at,
    assets[answer_of(object, annotator)] AS choice,
    CASE WHEN u(object * 4 + annotator, 'placed') < 0.1 THEN pose(yaw, x, y, 0.0) END AS pose,
    CASE WHEN u(object * 4 + annotator, 'placed') < 0.1 THEN [1.0, 1.0, 1.0] END AS scale,
    CASE
        WHEN answer_of(object, annotator) IS NULL THEN []
        ELSE [assets[answer_of(object, annotator)]] || list_filter(assets[1:4], lambda asset: asset <> assets[answer_of(object, annotator)])
    END AS ranking,
    pose(yaw, x, y, size_z / 2) AS box_pose,
    [size_x, size_y, size_z] AS box_size,
    'annotator-' || annotator || '.json' AS source_file,
    round(8 * exp(0.6 * normal(object * 4 + annotator, 'seconds')), 1) AS seconds,
    false AS is_withdrawn,
    'generated' AS tool,
    false AS is_simulated
FROM (
    SELECT
        *,
        unnest(range(1, 4)) AS annotator
    FROM objects_now
    WHERE is_annotated(scene)
)
JOIN (
    SELECT object, list(asset_of(object, slot, library.asset_id) ORDER BY rank) AS assets
    FROM ranks_now
    LEFT JOIN library ON library.library_index = ranks_now.library_index
    WHERE is_annotated(scene)
    GROUP BY object
) USING (object)
ORDER BY batch_id, scene_id, instance_id, annotator
