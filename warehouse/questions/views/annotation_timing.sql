-- How many minutes does a scene of 39 objects take, by the paper, by our people, and by our computers?
-- Version 1.
-- paper: 12 minutes of annotation per scene of 39 candidate objects, as it states. people: the time that all annotators together spent
-- on their answers (view annotation_timing_by_scene; missing where nobody measured any). computation: all stages of the scenes, as they
-- were run last, without any person; imports of finished datasets are no runs of the stages. minutes_per_39_objects scales the minutes
-- per object to a scene of the paper's size.
WITH people AS (
    SELECT
        count(minutes) AS scenes,
        CAST(coalesce(sum(objects), 0) AS BIGINT) AS objects,
        sum(minutes) AS minutes,
        quantile_cont(minutes, 0.5) AS median_minutes_per_scene
    FROM annotation_timing_by_scene
),
spent AS (
    SELECT runs.scene_id, sum(runs.seconds) / 60 AS minutes, any_value(counted.objects) AS objects
    FROM current_runs AS runs
    ANTI JOIN (SELECT scene_id FROM scenes WHERE segmentation = 'objects') AS imported USING (scene_id)
    JOIN objects_per_scene AS counted USING (scene_id)
    GROUP BY runs.scene_id
),
computation AS (
    SELECT
        count(*) AS scenes,
        CAST(coalesce(sum(objects), 0) AS BIGINT) AS objects,
        sum(minutes) AS minutes,
        quantile_cont(minutes, 0.5) AS median_minutes_per_scene
    FROM spent
    WHERE objects > 0
),
readings AS (
    SELECT
        1 AS place,
        'paper' AS reading,
        CAST(NULL AS BIGINT) AS scenes,
        CAST(NULL AS BIGINT) AS objects,
        CAST(NULL AS DOUBLE) AS minutes,
        CAST(NULL AS DOUBLE) AS median_minutes_per_scene,
        CAST(12.0 AS DOUBLE) AS minutes_per_scene,
        12.0 / 39 AS minutes_per_object
    UNION ALL
    SELECT 2, 'people', scenes, objects, minutes, median_minutes_per_scene, minutes / nullif(scenes, 0), minutes / nullif(objects, 0)
    FROM people
    UNION ALL
    SELECT 3, 'computation', scenes, objects, minutes, median_minutes_per_scene, minutes / nullif(scenes, 0), minutes / nullif(objects, 0)
    FROM computation
)
SELECT
    reading,
    scenes,
    objects,
    minutes,
    minutes_per_scene,
    median_minutes_per_scene,
    minutes_per_object,
    minutes_per_object * 39 AS minutes_per_39_objects,
    minutes_per_object * 39 / 12 AS times_paper
FROM readings
ORDER BY place
