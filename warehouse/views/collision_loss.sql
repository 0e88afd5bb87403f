-- How much do the assets of a scene overlap before and after the optimization?
WITH runs AS (
    SELECT
        scene_id,
        max(loss) FILTER (step = 0) AS loss_before_m3,
        arg_max(smallest_loss, step) AS loss_after_m3,
        count(*) FILTER (step > 0) AS steps,
        count(*) FILTER (outcome = 'kept') AS kept_steps
    FROM optimization_steps
    GROUP BY scene_id
),
touching AS (
    SELECT
        scene_id,
        count(*) FILTER (phase = 'proposed') AS contacts_before,
        count(*) FILTER (phase = 'optimized') AS contacts_after,
        max(penetration_m) FILTER (phase = 'proposed') AS deepest_before_m,
        max(penetration_m) FILTER (phase = 'optimized') AS deepest_after_m
    FROM contacts
    GROUP BY scene_id
)
SELECT
    scene_id,
    runs.loss_before_m3,
    runs.loss_after_m3,
    coalesce(runs.steps, 0) AS steps,
    coalesce(runs.kept_steps, 0) AS kept_steps,
    coalesce(touching.contacts_before, 0) AS contacts_before,
    coalesce(touching.contacts_after, 0) AS contacts_after,
    coalesce(touching.deepest_before_m, 0) AS deepest_before_m,
    coalesce(touching.deepest_after_m, 0) AS deepest_after_m
FROM runs
FULL JOIN touching USING (scene_id)
ORDER BY scene_id
