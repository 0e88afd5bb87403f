SELECT
    batch_id,
    1 AS round,
    scene_id,
    instance_id,
    annotator,
    1 AS revision,
    3 * objects AS answers,
    'annotator-1' AS submitted_by,
    at_second(scene * 100 + 80) AS submitted_at
FROM asked_now
ORDER BY batch_id, scene_id, instance_id, annotator
