-- What does the lake hold, in one row?
-- Version 1.
-- Stability is MuJoCo's verdict on the objects that are free to move.
SELECT
    (SELECT count(*) FROM scenes) AS scenes,
    (SELECT count(DISTINCT room_id) FROM scenes) AS rooms,
    (SELECT coalesce(sum(floor_area_m2), 0) FROM rooms) AS floor_area_m2,
    (SELECT count(*) FROM instances WHERE NOT is_structure) AS objects,
    (SELECT count(DISTINCT category) FROM instances WHERE NOT is_structure) AS categories,
    (SELECT count(*) FROM placements) AS placed_objects,
    (SELECT count(*) FROM assets) AS assets,
    (SELECT CAST(coalesce(sum(deep_pairs_after), 0) AS BIGINT) FROM collision_loss) AS deep_pairs,
    (SELECT CAST(coalesce(sum(free), 0) AS BIGINT) FROM stability WHERE engine = 'mujoco') AS free_objects,
    (SELECT CAST(coalesce(sum(fixed), 0) AS BIGINT) FROM stability WHERE engine = 'mujoco') AS fixed_objects,
    (SELECT CAST(coalesce(sum(stable_1cm), 0) AS BIGINT) FROM stability WHERE engine = 'mujoco') AS stable_1cm,
    (SELECT CAST(coalesce(sum(stable_5cm), 0) AS BIGINT) FROM stability WHERE engine = 'mujoco') AS stable_5cm,
    (SELECT count(*) FROM episodes) AS episodes,
    (SELECT count(*) FROM export_verdicts) AS exports,
    (SELECT count(*) FROM export_verdicts WHERE passed) AS exports_passed,
    (SELECT count(*) FROM failures) AS failures,
    (SELECT coalesce(sum(seconds), 0) FROM current_runs) AS total_seconds
