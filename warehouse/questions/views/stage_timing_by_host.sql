-- How long does each stage take on each host: per run (median, 95th percentile) and per object?
-- Version 2.
-- Runs that made the rows of today; imports of finished datasets are no runs of the stages. scenes counts as in the view stage_timing,
-- workers the processes of the host that ran the stage.
WITH current AS (
    SELECT * EXCLUDE (host), host AS worker, regexp_replace(host, ':[0-9]+$', '') AS host
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
        current.host,
        current.stage,
        count(DISTINCT CASE WHEN contains(current.scene_id, '/') THEN current.scene_id ELSE batches.scene_id END) AS scenes
    FROM current
    LEFT JOIN batches ON batches.batch_id = current.scene_id
    GROUP BY current.host, current.stage
),
timed AS (
    SELECT
        runs.host,
        runs.stage,
        count(*) AS runs,
        count(DISTINCT runs.worker) AS workers,
        sum(runs.seconds) AS total_seconds,
        quantile_cont(runs.seconds, [0.5, 0.95]) AS quantiles,
        max(runs.seconds) AS slowest_seconds,
        CAST(coalesce(sum(counted.objects), 0) AS BIGINT) AS objects,
        sum(runs.seconds) FILTER (counted.objects > 0) AS seconds_of_objects,
        max(runs.peak_memory_mb) AS peak_memory_mb
    FROM current AS runs
    LEFT JOIN objects_per_scene AS counted USING (scene_id)
    GROUP BY runs.host, runs.stage
)
SELECT
    host,
    stage,
    workers,
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
JOIN about USING (host, stage)
ORDER BY host, stage
