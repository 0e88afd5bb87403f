-- Every batch was reviewed once; one in five was returned.
SELECT
    batch_id,
    'round-1' AS review_id,
    'reviewer-' || (1 + below(any_value(scene), 'reviewer', 3)) AS reviewer,
    at_second(any_value(scene) * 100 + 90) AS reviewed_at,
    any_value(sampled) AS sampled,
    wrong_of(any_value(scene)) AS wrong,
    CASE WHEN wrong_of(any_value(scene)) > 0 THEN 'returned' ELSE 'accepted' END AS verdict,
    NULL AS note,
    'verdicts' AS source_file,
    1 AS round,
    count(*) AS answers,
    [sha256(string_agg(concat_ws('|', scene_id, instance_id, annotator, 1), chr(10) ORDER BY instance_id, annotator))]
        AS handed_in_hashes,
    1.0 - (wrong_of(any_value(scene)) + 2.0) / any_value(sampled) AS pass_low,
    1.0 - wrong_of(any_value(scene)) / any_value(sampled) AS pass_high,
    false AS is_simulated
FROM asked_now
GROUP BY batch_id
