-- How long does each stage take: in all, per scene (median, 95th percentile) and per object?
-- Runs that made the rows of today. An annotation batch counts as a scene, but has no objects.
SELECT
    runs.stage,
    count(*) AS scenes,
    sum(runs.seconds) AS total_seconds,
    quantile_cont(runs.seconds, 0.5) AS median_seconds,
    quantile_cont(runs.seconds, 0.95) AS p95_seconds,
    max(runs.seconds) AS slowest_seconds,
    CAST(coalesce(sum(counted.objects), 0) AS BIGINT) AS objects,
    sum(runs.seconds) FILTER (counted.objects > 0) / nullif(sum(counted.objects), 0) AS seconds_per_object,
    max(runs.peak_memory_mb) AS peak_memory_mb
FROM current_runs AS runs
LEFT JOIN objects_per_scene AS counted USING (scene_id)
GROUP BY runs.stage
ORDER BY runs.stage
