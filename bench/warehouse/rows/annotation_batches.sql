SELECT
    batch_of(scene) AS batch_id,
    'created' AS origin,
    at_second(scene * 100) AS created_at,
    'all' AS pick,
    3 AS overlap,
    0 AS seed,
    0.1 AS sample_share,
    50 AS least_sample,
    0.98 AS pass_share,
    false AS counts_unreviewed
FROM scenes_now
WHERE is_annotated(scene)
