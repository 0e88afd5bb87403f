-- What is each scene, how far has it come, how long did that take, and how much of it stands?
-- Version 1.
-- One row per scene, also where its capture failed and nothing else is known of it. stages_done counts stages whose rows are there,
-- stages_failed those that failed or were lost at their last attempt (view failures), whose older rows may be there; error is of the first.
-- seconds is the time that the rows of today took. stable_5cm_share is MuJoCo's verdict (view stability).
WITH known AS (
    SELECT scene_id
    FROM scenes
    UNION
    SELECT scene_id
    FROM stage_runs
    WHERE stage = 'capture'
),
done AS (
    SELECT scene_id, count(*) AS stages, sum(seconds) AS seconds
    FROM current_runs
    GROUP BY scene_id
),
failed AS (
    SELECT scene_id, count(*) AS stages, list(stage ORDER BY stage) AS failed_stages, first(error ORDER BY stage) FILTER (error IS NOT NULL) AS error
    FROM failures
    GROUP BY scene_id
)
SELECT
    known.scene_id,
    scenes.room_id,
    coalesce(scenes.dataset, split_part(known.scene_id, '/', 1)) AS dataset,
    scenes.scan_format,
    held.room_type,
    held.rooms,
    held.floor_area_m2,
    held.objects,
    coalesce(done.stages, 0) AS stages_done,
    coalesce(failed.stages, 0) AS stages_failed,
    coalesce(failed.failed_stages, []) AS failed_stages,
    failed.error,
    coalesce(done.seconds, 0) AS seconds,
    stability.stable_5cm_share
FROM known
LEFT JOIN scenes USING (scene_id)
LEFT JOIN objects_per_scene AS held USING (scene_id)
LEFT JOIN done USING (scene_id)
LEFT JOIN failed USING (scene_id)
LEFT JOIN stability ON stability.scene_id = known.scene_id AND stability.engine = 'mujoco'
ORDER BY known.scene_id
