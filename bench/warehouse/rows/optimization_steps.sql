SELECT
    scene_id,
    step,
    CASE WHEN step > 0 THEN name_of(structures + below(move, 'moved', objects)) END AS instance_id,
    CASE WHEN step > 0 THEN round(0.1 * u(move, 'dx') - 0.05, 3) ELSE 0.0 END AS dx_m,
    CASE WHEN step > 0 THEN round(0.1 * u(move, 'dy') - 0.05, 3) ELSE 0.0 END AS dy_m,
    CASE WHEN step > 0 THEN round(0.02 * u(move, 'dz') - 0.01, 3) ELSE 0.0 END AS dz_m,
    0.0 AS turn_x_radians,
    0.0 AS turn_y_radians,
    CASE WHEN u(move, 'turned') < 0.1 THEN round(0.5 * u(move, 'turn'), 3) ELSE 0.0 END AS turn_z_radians,
    round(0.1 * (1 - step / 100) ** 2, 6) AS loss,
    round(0.1 * (1 - step / 100) ** 2, 6) AS smallest_loss,
    CASE
        WHEN step = 0 THEN 'start' WHEN u(move, 'outcome') < 0.03 THEN 'rested' WHEN u(move, 'outcome') < 0.04 THEN 'hung'
        WHEN u(move, 'outcome') < 0.05 THEN 'tipped' ELSE 'kept'
    END AS outcome
FROM (SELECT *, scene * 1000 + step AS move FROM (SELECT *, unnest(range(100)) AS step FROM scenes_now))
