-- One in five batches has answers that do not pass, those that were drawn first.
SELECT
    batch_id,
    1 AS round,
    scene_id,
    instance_id,
    annotator,
    1 AS number,
    'reviewer-' || (1 + below(scene, 'reviewer', 3)) AS reviewer,
    at_second(scene * 100 + 90) AS reviewed_at,
    drawn > wrong_of(scene) AS passes,
    CASE WHEN drawn <= wrong_of(scene) THEN 'stands beside what was scanned' END AS remark,
    'verdicts' AS source_file,
    false AS is_simulated
FROM asked_now
WHERE drawn <= sampled
ORDER BY batch_id, scene_id, instance_id, annotator
