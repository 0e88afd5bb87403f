-- Every batch was reviewed once; one in five was returned.
SELECT
    batch_of(scene) AS batch_id,
    'review-1' AS review_id,
    'reviewer-' || (1 + below(scene, 'reviewer', 3)) AS reviewer,
    at_second(scene * 100 + 90) AS reviewed_at,
    20 AS sampled,
    CASE WHEN u(scene, 'returned') < 0.2 THEN 3 + below(scene, 'wrong', 5) ELSE below(scene, 'wrong', 2) END AS wrong,
    CASE WHEN u(scene, 'returned') < 0.2 THEN 'returned' ELSE 'accepted' END AS verdict,
    NULL AS note,
    'review-1.json' AS source_file
FROM scenes_now
WHERE is_annotated(scene)
