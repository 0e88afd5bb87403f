SELECT
    scene_id,
    instance_id,
    relation,
    CASE WHEN relation IN ('on', 'inside') THEN name_of(structures + (number + 1 + below(thing, 'parent', objects - 1)) % objects) END
        AS parent_id,
    CASE
        WHEN relation = 'wall' THEN 'wall_0' || below(thing, 'wall', 4)
        WHEN relation = 'ceiling' THEN 'ceiling'
        WHEN u(thing, 'against') < 0.3 THEN 'wall_0' || below(thing, 'wall', 4)
    END AS against,
    CASE WHEN u(thing, 'gap') < 0.2 THEN round(0.05 * u(thing, 'height') - 0.02, 3) ELSE 0.0 END AS gap_m,
    relation IN ('wall', 'ceiling') AS is_fixed,
    u(thing, 'kept') < 0.98 AS is_kept
FROM (
    SELECT
        *,
        CASE
            WHEN u(thing, 'relation') < 0.40 THEN 'floor' WHEN u(thing, 'relation') < 0.70 THEN 'on'
            WHEN u(thing, 'relation') < 0.80 THEN 'inside' WHEN u(thing, 'relation') < 0.97 THEN 'wall'
            WHEN u(thing, 'relation') < 0.995 THEN 'ceiling' ELSE 'none'
        END AS relation
    FROM objects_now
)
