-- How long does each stage take: in all, per run (median, 95th percentile) and per object?
-- Version 2.
-- Runs that made the rows of today; imports of finished datasets are no runs of the stages. A run is of one scene, or of one batch of
-- annotations, reviews or trajectories: scenes counts those that it has answers or trajectories of, objects none.
WITH current AS (
    SELECT *
    FROM current_runs
    ANTI JOIN (SELECT scene_id FROM scenes WHERE segmentation = 'objects') AS imported USING (scene_id)
),
batches AS (
    SELECT batch_id, scene_id FROM trajectories
    UNION
    SELECT batch_id, scene_id FROM annotations
),
about AS (
    SELECT
        current.stage,
        count(DISTINCT CASE WHEN contains(current.scene_id, '/') THEN current.scene_id ELSE batches.scene_id END) AS scenes
    FROM current
    LEFT JOIN batches ON batches.batch_id = current.scene_id
    GROUP BY current.stage
),
timed AS (
    SELECT
        runs.stage,
        count(*) AS runs,
        sum(runs.seconds) AS total_seconds,
        quantile_cont(runs.seconds, [0.5, 0.95]) AS quantiles,
        max(runs.seconds) AS slowest_seconds,
        CAST(coalesce(sum(counted.objects), 0) AS BIGINT) AS objects,
        sum(runs.seconds) FILTER (counted.objects > 0) AS seconds_of_objects,
        max(runs.peak_memory_mb) AS peak_memory_mb
    FROM current AS runs
    LEFT JOIN objects_per_scene AS counted USING (scene_id)
    GROUP BY runs.stage
)
SELECT
    stage,
    about.scenes,
    runs,
    total_seconds,
    quantiles[1] AS median_seconds,
    quantiles[2] AS p95_seconds,
    slowest_seconds,
    objects,
    seconds_of_objects / nullif(objects, 0) AS seconds_per_object,
    peak_memory_mb
FROM timed
JOIN about USING (stage)
ORDER BY stage
