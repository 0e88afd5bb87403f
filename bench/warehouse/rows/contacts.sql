-- An object and the next one, or the floor for the last.
SELECT
    scene_id,
    phase,
    name_of(place) AS instance_a,
    CASE WHEN place + 1 < structures + objects THEN name_of(place + 1) ELSE 'floor' END AS body_b,
    CASE WHEN place + 1 < structures + objects THEN round(0.01 * u(object, 'overlap'), 4) ELSE 0.0 END AS box_overlap_m3,
    CASE
        WHEN phase = 'proposed' THEN round(0.03 * u(object, 'depth before'), 4)
        WHEN u(object, 'depth after') < 0.01 THEN 0.005
        ELSE round(0.002 * u(object, 'depth after'), 4)
    END AS penetration_m,
    u(object, 'allowed') < 0.1 AS is_allowed
FROM (
    SELECT *, scene * 1000 + place AS object
    FROM (
        SELECT *, unnest(range(structures, structures + objects)) AS place
        FROM (SELECT *, unnest(['optimized', 'proposed']) AS phase FROM scenes_now)
    )
)
WHERE u(object, 'touches ' || phase) < 0.45
