-- Of the walks in compared_runs; whether one is better than the other is made up.
SELECT
    'comparison-' || part AS comparison_id,
    split_part(scene_id, '/', 1) AS tested_on,
    'scans' AS first,
    'scenes' AS second,
    measure,
    10 * count(*) AS pairs,
    count(*) AS scenes,
    1 AS seeds,
    0.4 AS first_mean,
    0.6 AS second_mean,
    2 * count(*) AS only_first,
    4 * count(*) AS only_second,
    0.05 AS p_value,
    CASE WHEN count(*) > 1 THEN 0.5 END AS p_value_by_scene,
    NULL AS p_value_by_seed
FROM scenes_now
CROSS JOIN (VALUES ('success'), ('spl')) AS measures(measure)
WHERE scene % 100 = 3
GROUP BY ALL
