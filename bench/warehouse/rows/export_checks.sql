-- The rules of the five formats; a broken export breaks one of them.
SELECT
    scene_id,
    format,
    rule,
    NOT fails AS passed,
    CASE WHEN fails THEN 'a file says otherwise' END AS message
FROM (
    SELECT *, is_broken(scene, format) AND below(scene, 'broken rule ' || format, rules_of_format) = place AS fails
    FROM (SELECT *, unnest(getvariable('rules')) AS checked FROM scenes_now), LATERAL (
        SELECT checked.format AS format, checked.rule AS rule, checked.place AS place, checked.rules AS rules_of_format
    )
)
