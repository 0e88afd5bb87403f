-- How long did each scene take, and which of its stages took longest?
-- Version 1.
-- The run of an import of a finished dataset counts as well, all its time as capture.
SELECT
    runs.scene_id,
    count(*) AS stages,
    sum(runs.seconds) AS total_seconds,
    first(runs.stage ORDER BY runs.seconds DESC, runs.stage) AS slowest_stage,
    max(runs.seconds) AS slowest_seconds,
    sum(runs.seconds) / nullif(any_value(counted.objects), 0) AS seconds_per_object,
    max(runs.peak_memory_mb) AS peak_memory_mb
FROM current_runs AS runs
JOIN objects_per_scene AS counted USING (scene_id)
GROUP BY runs.scene_id
ORDER BY runs.scene_id
