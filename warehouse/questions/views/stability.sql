-- How many objects of each scene stay where they were put, left alone under gravity?
-- Version 2.
-- Shares, the worst and the deepest are of the free objects; those that hang or are built in cannot fail, so their share is given beside.
-- stable_nudged: within 1 cm and 5 degrees after each of four nudges; missing where not all free objects were nudged.
-- An object that was placed but has no certificate of that engine is uncertified; so is one that the engine could not simulate, which,
-- if it is free, is not stable either.
WITH judged AS (
    SELECT
        scene_id,
        engine,
        min(engine_version) AS engine_version,
        count(*) AS objects,
        count(*) FILTER (problem IS NOT NULL) AS refused,
        count(*) FILTER (NOT is_fixed) AS free,
        count(*) FILTER (is_fixed) AS fixed,
        count(*) FILTER (NOT is_fixed AND is_stable_1cm) AS stable_1cm,
        count(*) FILTER (NOT is_fixed AND is_stable_5cm) AS stable_5cm,
        count(*) FILTER (NOT is_fixed AND is_stable_nudged) AS stable_nudged,
        count(is_stable_nudged) FILTER (NOT is_fixed) AS nudged,
        max(displacement_m) FILTER (NOT is_fixed) AS worst_displacement_m,
        degrees(max(tilt_radians) FILTER (NOT is_fixed)) AS worst_tilt_degrees,
        arg_max(instance_id, displacement_m) FILTER (NOT is_fixed) AS worst_instance_id,
        max(start_penetration_m) FILTER (NOT is_fixed) AS deepest_start_penetration_m
    FROM certificates
    GROUP BY scene_id, engine
),
placed AS (
    SELECT scene_id, count(*) AS objects
    FROM placements
    GROUP BY scene_id
)
SELECT
    judged.scene_id,
    judged.engine,
    judged.engine_version,
    judged.objects,
    judged.free,
    judged.fixed,
    judged.fixed / judged.objects AS fixed_share,
    judged.stable_1cm,
    judged.stable_5cm,
    judged.stable_1cm / nullif(judged.free, 0) AS stable_1cm_share,
    judged.stable_5cm / nullif(judged.free, 0) AS stable_5cm_share,
    CASE WHEN judged.nudged = judged.free THEN judged.stable_nudged END AS stable_nudged,
    CASE WHEN judged.nudged = judged.free THEN judged.stable_nudged / nullif(judged.free, 0) END AS stable_nudged_share,
    judged.worst_instance_id,
    judged.worst_displacement_m,
    judged.worst_tilt_degrees,
    judged.deepest_start_penetration_m,
    judged.refused,
    greatest(coalesce(placed.objects, 0) - judged.objects, 0) + judged.refused AS uncertified
FROM judged
LEFT JOIN placed USING (scene_id)
ORDER BY judged.scene_id, judged.engine
