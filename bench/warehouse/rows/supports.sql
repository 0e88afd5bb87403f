SELECT
    scene_id,
    instance_id,
    relation,
    CASE WHEN relation IN ('on', 'inside') THEN name_of(structures + (number + 1 + below(object, 'parent', objects - 1)) % objects) END
        AS parent_id,
    CASE
        WHEN relation = 'wall' THEN 'wall_0' || below(object, 'wall', 4)
        WHEN relation = 'ceiling' THEN 'ceiling'
        WHEN u(object, 'against') < 0.3 THEN 'wall_0' || below(object, 'wall', 4)
    END AS against,
    CASE WHEN u(object, 'gap') < 0.2 THEN round(0.05 * u(object, 'height') - 0.02, 3) ELSE 0.0 END AS gap_m,
    relation IN ('wall', 'ceiling') AS is_fixed,
    u(object, 'kept') < 0.98 AS is_kept,
    FALSE AS is_inferred,
    NULL AS bracket_blob
FROM (
    SELECT
        *,
        CASE
            WHEN u(object, 'relation') < 0.40 THEN 'floor' WHEN u(object, 'relation') < 0.70 THEN 'on'
            WHEN u(object, 'relation') < 0.80 THEN 'inside' WHEN u(object, 'relation') < 0.97 THEN 'wall'
            WHEN u(object, 'relation') < 0.995 THEN 'ceiling' ELSE 'none'
        END AS relation
    FROM objects_now
)
