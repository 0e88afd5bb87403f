-- What does the lake hold, in one row?
-- Version 3.
-- Stability is MuJoCo's verdict on the objects that are free to move. assets counts those of all candidates, placed or not.
-- median_object_f_5cm is over the scenes whose fidelity was measured; each has its own in scene_fidelity_overview.
SELECT
    (SELECT count(*) FROM scenes) AS scenes,
    (SELECT count(DISTINCT room_id) FROM scenes) AS rooms,
    (SELECT coalesce(sum(floor_area_m2), 0) FROM shells) AS floor_area_m2,
    (SELECT count(*) FROM instances WHERE NOT is_structure) AS objects,
    (SELECT count(DISTINCT category) FROM instances WHERE NOT is_structure) AS categories,
    (SELECT count(*) FROM placements) AS placed_objects,
    (SELECT count(*) FROM assets) AS assets,
    (
        SELECT count(*)
        FROM contacts
        WHERE phase = 'optimized' AND penetration_m > 0.002 AND NOT is_allowed
    ) AS deep_pairs,
    judged.free_objects,
    judged.fixed_objects,
    judged.stable_1cm,
    judged.stable_5cm,
    judged.stable_nudged,
    (SELECT median(object_f_5cm) FROM scene_fidelity) AS median_object_f_5cm,
    (SELECT count(*) FROM episodes) AS episodes,
    exported.exports,
    exported.passed AS exports_passed,
    (SELECT count(*) FROM failures) AS failures,
    (SELECT coalesce(sum(seconds), 0) FROM current_runs) AS total_seconds
FROM (
    SELECT count(*) AS exports, count(*) FILTER (passed) AS passed
    FROM export_verdicts
) AS exported,
(
    SELECT
        count(*) FILTER (NOT is_fixed) AS free_objects,
        count(*) FILTER (is_fixed) AS fixed_objects,
        count(*) FILTER (NOT is_fixed AND is_stable_1cm) AS stable_1cm,
        count(*) FILTER (NOT is_fixed AND is_stable_5cm) AS stable_5cm,
        CASE
            WHEN count(*) FILTER (NOT is_fixed) = count(is_stable_nudged) FILTER (NOT is_fixed)
                THEN count(*) FILTER (NOT is_fixed AND is_stable_nudged)
        END AS stable_nudged
    FROM certificates
    WHERE engine = 'mujoco'
) AS judged
