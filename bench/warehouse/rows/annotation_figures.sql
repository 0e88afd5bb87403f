SELECT
    batch_id,
    scene_id,
    instance_id,
    annotator,
    1 AS revision,
    u(object * 4 + annotator_number, 'match') < 0.9 AS is_category_match,
    round(exp(0.3 * normal(object * 4 + annotator_number, 'ratio')), 3) AS size_ratio,
    below(object, 'alike', 3) AS lookalikes,
    below(object, 'alike', 2) AS lookalikes_alike,
    CASE WHEN u(object * 4 + annotator_number, 'deep') < 0.2 THEN 0.01 ELSE 0.0 END AS collision_m,
    CASE WHEN u(object * 4 + annotator_number, 'deep') < 0.2 THEN 'wall_00' END AS collides_with,
    round(0.01 * normal(object * 4 + annotator_number, 'floats'), 4) AS floating_m,
    CASE WHEN u(object * 4 + annotator_number, 'outside') < 0.05 THEN 0.1 ELSE 0.0 END AS outside_share,
    round(0.02 * exp(0.5 * normal(object * 4 + annotator_number, 'distance')), 4) AS scan_distance_m
FROM asked_now
WHERE answer_of(object, annotator_number) IS NOT NULL
ORDER BY batch_id, scene_id, instance_id, annotator
