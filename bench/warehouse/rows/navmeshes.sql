SELECT
    scene_id,
    'cylinder_r18_h88' AS agent,
    0.18 AS agent_radius_m,
    0.88 AS agent_height_m,
    digest('navmesh', scene) || '.navmesh' AS navmesh_blob,
    room_width * room_depth * (0.3 + 0.4 * u(scene, 'free')) AS area_m2,
    room_width * room_depth * (0.3 + 0.4 * u(scene, 'free')) * (0.9 + 0.1 * u(scene, 'island')) AS largest_island_m2,
    1 + below(scene, 'islands', 4) AS island_count,
    'planar' AS path_finder
FROM scenes_now
