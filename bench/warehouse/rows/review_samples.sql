SELECT
    batch_id,
    1 AS round,
    scene_id,
    instance_id,
    annotator,
    1 AS revision,
    drawn AS place,
    sampled,
    at_second(scene * 100 + 85) AS drawn_at
FROM asked_now
WHERE drawn <= sampled
ORDER BY batch_id, scene_id, instance_id, annotator
