SELECT
    batch_id,
    scene_id,
    instance_id,
    annotator,
    number + 1 AS place,
    round(u(object, 'doubt'), 3) AS doubt,
    ['never answered'] AS reasons,
    NULL AS proposed
FROM asked_now
ORDER BY batch_id, scene_id, instance_id, annotator
