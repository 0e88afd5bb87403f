-- How much do the assets of a scene collide before and after the optimization?
-- Version 2.
-- The loss is a sum of IoU by the method 'paper', overlap volume in m3 by 'released', penetration depth in m by 'default'. A pair is
-- deep beyond 2 mm; pairs that may interpenetrate, such as a picture and its wall, are left out.
WITH steps AS (
    SELECT
        scene_id,
        count(*) FILTER (outcome IN ('pulled_in', 'hung', 'rested', 'kept', 'tipped', 'laid_down', 'relocated', 'fallen')) AS applied_steps
    FROM optimization_steps
    GROUP BY scene_id
),
touching AS (
    SELECT
        scene_id,
        count(*) FILTER (phase = 'proposed' AND penetration_m > 0.002) AS deep_pairs_before,
        count(*) FILTER (phase = 'optimized' AND penetration_m > 0.002) AS deep_pairs_after,
        max(penetration_m) FILTER (phase = 'proposed') AS deepest_before_m,
        max(penetration_m) FILTER (phase = 'optimized') AS deepest_after_m
    FROM contacts
    WHERE NOT is_allowed
    GROUP BY scene_id
)
SELECT
    scene_id,
    optimizations.method,
    CASE optimizations.method WHEN 'paper' THEN '1' WHEN 'released' THEN 'm3' WHEN 'default' THEN 'm' END AS loss_unit,
    optimizations.loss_start AS loss_before,
    optimizations.loss_final AS loss_after,
    optimizations.moves,
    coalesce(steps.applied_steps, 0) AS applied_steps,
    optimizations.ended,
    coalesce(touching.deep_pairs_before, 0) AS deep_pairs_before,
    coalesce(touching.deep_pairs_after, 0) AS deep_pairs_after,
    coalesce(touching.deepest_before_m, 0) AS deepest_before_m,
    coalesce(touching.deepest_after_m, 0) AS deepest_after_m
FROM optimizations
FULL JOIN touching USING (scene_id)
LEFT JOIN steps USING (scene_id)
ORDER BY scene_id
