-- One scene in a hundred was walked by the expert and at random, each in a batch of its own.
SELECT
    concat(policy, '-', lpad(CAST(scene // 100 AS VARCHAR), 5, '0')) AS batch_id,
    scene_id,
    name_of(episode) AS episode_id,
    policy,
    'built-in' AS run_name,
    'cylinder_r18_h88' AS agent,
    split,
    name_of(place) AS instance_id,
    category,
    [start_x, start_y, 0.0] AS start_position,
    start_yaw AS start_yaw_radians,
    actions_of(trip, forwards) AS actions,
    list_transform(
        range(forwards + forwards // 3 + 2),
        lambda step: [start_x + 0.2 * step, start_y + 0.05 * ((step + trip) % 7), start_yaw + 0.1 * (step % 5)]
    ) AS poses,
    TRUE AS called_stop,
    CASE policy WHEN 'expert' THEN 0 ELSE below(trip, 'collisions', 10) END AS collisions,
    forwards * 0.25 AS travelled_m,
    geodesic AS start_distance_m,
    CASE policy WHEN 'expert' THEN 0.1 * u(trip, 'end') ELSE 3 * u(trip, 'end') END AS final_distance_m,
    0.2 AS success_distance_m,
    forwards + forwards // 3 + 1 AS expert_actions,
    'planar' AS path_finder,
    NULL AS problem,
    NULL AS source_file
FROM (SELECT *, unnest(getvariable('policies')) AS policy FROM episodes_now WHERE scene % 100 = 3)
ORDER BY batch_id, scene_id, episode_id
