-- How many objects of each category stay where they were put, left alone under gravity?
-- Version 1.
-- The view stability, by category and over all scenes. Shares, and what moved, are of the free objects; shares have Wilson's interval of
-- 95 %. One that the engine could not simulate (refused) is not stable, if it is free. stable_nudged: of those that were nudged.
WITH counted AS (
    SELECT
        instances.category,
        certificates.engine,
        count(*) AS objects,
        count(DISTINCT certificates.scene_id) AS scenes,
        count(*) FILTER (NOT certificates.is_fixed) AS free,
        count(*) FILTER (certificates.is_fixed) AS fixed,
        count(*) FILTER (NOT certificates.is_fixed AND certificates.is_stable_1cm) AS stable_1cm,
        count(*) FILTER (NOT certificates.is_fixed AND certificates.is_stable_5cm) AS stable_5cm,
        count(certificates.is_stable_nudged) FILTER (NOT certificates.is_fixed) AS nudged,
        count(*) FILTER (NOT certificates.is_fixed AND certificates.is_stable_nudged) AS stable_nudged,
        quantile_cont(certificates.displacement_m, 0.5) FILTER (NOT certificates.is_fixed) AS median_displacement_m,
        max(certificates.displacement_m) FILTER (NOT certificates.is_fixed) AS worst_displacement_m,
        degrees(max(certificates.tilt_radians) FILTER (NOT certificates.is_fixed)) AS worst_tilt_degrees,
        count(certificates.problem) AS refused
    FROM certificates
    LEFT JOIN instances USING (scene_id, instance_id)
    GROUP BY instances.category, certificates.engine
)
SELECT
    category,
    engine,
    objects,
    scenes,
    free,
    fixed,
    fixed / objects AS fixed_share,
    stable_1cm,
    stable_1cm / nullif(free, 0) AS stable_1cm_share,
    stable_5cm,
    stable_5cm / nullif(free, 0) AS stable_5cm_share,
    wilson_interval(stable_5cm, free).low AS stable_5cm_share_low,
    wilson_interval(stable_5cm, free).high AS stable_5cm_share_high,
    nudged,
    stable_nudged,
    stable_nudged / nullif(nudged, 0) AS stable_nudged_share,
    median_displacement_m,
    worst_displacement_m,
    worst_tilt_degrees,
    refused
FROM counted
ORDER BY engine, objects DESC, category
