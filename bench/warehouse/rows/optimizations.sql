SELECT
    scene_id,
    'default' AS method,
    objects AS object_count,
    round(0.05 + 0.1 * u(scene, 'loss'), 5) AS loss_start,
    CASE WHEN u(scene, 'ended') < 0.9 THEN 0.0 ELSE round(0.01 * u(scene, 'loss'), 5) END AS loss_final,
    500 + below(scene, 'moves', 20000) AS moves,
    4 AS chains,
    CASE WHEN u(scene, 'ended') < 0.9 THEN 'zero_loss' WHEN u(scene, 'ended') < 0.97 THEN 'no_move_helps' ELSE 'out_of_moves' END AS ended,
    below(scene, 'fixed', 10) AS fixed_count,
    CASE WHEN u(scene, 'ended') < 0.9 THEN 0 ELSE 1 + below(scene, 'deep', 4) END AS deep_pairs,
    CASE WHEN u(scene, 'ended') < 0.9 THEN [] ELSE ['two objects still collide'] END AS remains
FROM scenes_now
