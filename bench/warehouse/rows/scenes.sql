SELECT
    scene_id,
    room_id,
    'generated' AS dataset,
    split_part(scene_id, '/', 2) AS scan,
    CASE WHEN u(scene, 'format') < 0.9 THEN 'scannet' ELSE 'posed_rgbd' END AS scan_format,
    '/scans/' || scene_id AS scan_path,
    pose(turn, x, y, 0.0) AS alignment,
    CASE WHEN u(scene, 'aligned') < 0.8 THEN 'file' ELSE 'estimated' END AS alignment_source,
    pose(-turn, -cos(turn) * x - sin(turn) * y, sin(turn) * x - cos(turn) * y, 0.0) AS to_original,
    0.05 * u(scene, 'tilt') AS floor_tilt_radians,
    digest('scan mesh', scene) || '.glb' AS mesh_blob,
    100000 + below(scene, 'vertices', 300000) AS vertex_count,
    200000 + below(scene, 'faces', 400000) AS face_count,
    100 AS frame_count,
    structures + objects AS instance_count,
    CASE WHEN u(scene, 'segmented') < 0.9 THEN 'file' ELSE 'geometry' END AS segmentation,
    CASE WHEN u(scene, 'license') < 0.5 THEN 'CC0-1.0' WHEN u(scene, 'license') < 0.9 THEN 'LicenseRef-scan' END AS license
FROM (
    SELECT *, 2 * pi() * u(scene, 'alignment') AS turn, u(scene, 'alignment x') AS x, u(scene, 'alignment y') AS y FROM scenes_now
)
