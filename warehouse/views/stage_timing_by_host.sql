-- How long does each stage take on each host: per scene (median, 95th percentile) and per object?
-- Version 1.
-- Runs that made the rows of today; imports of finished datasets are no runs of the stages.
-- workers counts the processes of the host that ran the stage.
WITH timed AS (
    SELECT
        regexp_replace(runs.host, ':[0-9]+$', '') AS host,
        runs.stage,
        count(*) AS scenes,
        count(DISTINCT runs.host) AS workers,
        sum(runs.seconds) AS total_seconds,
        quantile_cont(runs.seconds, [0.5, 0.95]) AS quantiles,
        max(runs.seconds) AS slowest_seconds,
        CAST(coalesce(sum(counted.objects), 0) AS BIGINT) AS objects,
        sum(runs.seconds) FILTER (counted.objects > 0) AS seconds_of_objects,
        max(runs.peak_memory_mb) AS peak_memory_mb
    FROM current_runs AS runs
    ANTI JOIN (SELECT scene_id FROM scenes WHERE segmentation = 'objects') AS imported USING (scene_id)
    LEFT JOIN objects_per_scene AS counted USING (scene_id)
    GROUP BY ALL
)
SELECT
    host,
    stage,
    workers,
    scenes,
    total_seconds,
    quantiles[1] AS median_seconds,
    quantiles[2] AS p95_seconds,
    slowest_seconds,
    objects,
    seconds_of_objects / nullif(objects, 0) AS seconds_per_object,
    peak_memory_mb
FROM timed
ORDER BY host, stage
