-- How many minutes does an object take, in the paper, of people here, and of computers here?
-- Version 2.
-- paper_annotation: 2 minutes of an annotator's time per object, as the paper states. paper_preprocessing: 12 minutes of computation per
-- scene of 39 objects, as it states; the creation of candidates is not in it. people: the time that all annotators together spent
-- on their answers (view annotation_timing_by_scene; missing if nobody measured any), compared with paper_annotation. computation: all
-- stages of the scenes as they were last run, candidates included, compared with paper_preprocessing; imports of finished datasets are
-- not runs of the stages. minutes_per_39_objects scales the minutes per object to a scene of the paper's size.
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
        'paper_annotation' AS reading,
        2.0 AS paper_minutes_per_object,
        CAST(NULL AS BIGINT) AS scenes,
        CAST(NULL AS BIGINT) AS objects,
        CAST(NULL AS DOUBLE) AS minutes,
        CAST(NULL AS DOUBLE) AS median_minutes_per_scene,
        CAST(2.0 * 39 AS DOUBLE) AS minutes_per_scene,
        CAST(2.0 AS DOUBLE) AS minutes_per_object
    UNION ALL
    SELECT 2, 'paper_preprocessing', 12.0 / 39, NULL, NULL, NULL, NULL, 12.0, 12.0 / 39
    UNION ALL
    SELECT 3, 'people', 2.0, scenes, objects, minutes, median_minutes_per_scene, minutes / nullif(scenes, 0), minutes / nullif(objects, 0)
    FROM people
    UNION ALL
    SELECT
        4, 'computation', 12.0 / 39, scenes, objects, minutes, median_minutes_per_scene, minutes / nullif(scenes, 0),
        minutes / nullif(objects, 0)
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
    minutes_per_object / paper_minutes_per_object AS times_paper
FROM readings
ORDER BY place
