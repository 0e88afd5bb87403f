-- What does the lake hold, in one row?
-- Version 1.
-- Stability is MuJoCo's verdict on the objects that are free to move. assets counts those of all candidates, placed or not.
SELECT
    (SELECT count(*) FROM scenes) AS scenes,
    (SELECT count(DISTINCT room_id) FROM scenes) AS rooms,
    (SELECT coalesce(sum(floor_area_m2), 0) FROM rooms) AS floor_area_m2,
    (SELECT count(*) FROM instances WHERE NOT is_structure) AS objects,
    (SELECT count(DISTINCT category) FROM instances WHERE NOT is_structure) AS categories,
    (SELECT count(*) FROM placements) AS placed_objects,
    (SELECT count(face_count) FROM assets) AS assets,
    (
        SELECT count(*)
        FROM contacts
        WHERE phase = 'optimized' AND penetration_m > 0.002 AND NOT is_allowed
    ) AS deep_pairs,
    (SELECT count(*) FROM certificates WHERE engine = 'mujoco' AND NOT is_fixed) AS free_objects,
    (SELECT count(*) FROM certificates WHERE engine = 'mujoco' AND is_fixed) AS fixed_objects,
    (SELECT count(*) FROM certificates WHERE engine = 'mujoco' AND NOT is_fixed AND is_stable_1cm) AS stable_1cm,
    (SELECT count(*) FROM certificates WHERE engine = 'mujoco' AND NOT is_fixed AND is_stable_5cm) AS stable_5cm,
    (SELECT count(*) FROM episodes) AS episodes,
    (SELECT count(*) FROM export_verdicts) AS exports,
    (SELECT count(*) FROM export_verdicts WHERE passed) AS exports_passed,
    (SELECT count(*) FROM failures) AS failures,
    (SELECT coalesce(sum(seconds), 0) FROM current_runs) AS total_seconds
