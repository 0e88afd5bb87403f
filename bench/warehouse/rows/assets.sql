-- The library's assets that this part names first, and what was cut from the scans of its objects.
SELECT
    asset_id,
    provider,
    concat(category, ' ', left(asset_id, 6)) AS name,
    category,
    CASE provider WHEN 'procedural' THEN 'furniture generator' ELSE 'library.json' END AS source,
    license,
    author,
    CASE WHEN provider <> 'procedural' THEN 'https://models.example/' || left(asset_id, 12) END AS source_url,
    asset_id || '.glb' AS mesh_blob,
    digest('pieces', asset_id) || '.glb' AS pieces_blob,
    digest('thumbnail', asset_id) || '.png' AS thumbnail_blob,
    [size, size, size] AS extents,
    volume * 0.3 AS volume_m3,
    u(asset_id, 'closed') < 0.9 AS is_watertight,
    CASE WHEN u(asset_id, 'closed') >= 0.9 THEN '12 edges of one face' END AS open_reason,
    u(asset_id, 'texture') < 0.3 AS has_texture,
    100 + below(asset_id, 'vertices', 20000) AS vertex_count,
    200 + below(asset_id, 'faces', 40000) AS face_count
FROM (SELECT *, exp(log_volume + log_spread * normal(asset_id, 'volume')) AS volume, cbrt(volume) AS size FROM library)
WHERE first_part = getvariable('part')
UNION ALL
SELECT
    digest('own asset', object) AS asset_id,
    'scan_crop_closed' AS provider,
    category || ' cut from the scan' AS name,
    category,
    'scan ' || scene_id AS source,
    'LicenseRef-scan' AS license,
    NULL AS author,
    NULL AS source_url,
    digest('own asset', object) || '.glb' AS mesh_blob,
    NULL AS pieces_blob,
    digest('own thumbnail', object) || '.png' AS thumbnail_blob,
    [size_x, size_y, size_z] AS extents,
    volume * 0.3 AS volume_m3,
    TRUE AS is_watertight,
    NULL AS open_reason,
    FALSE AS has_texture,
    100 + below(object, 'vertices', 5000) AS vertex_count,
    200 + below(object, 'faces', 10000) AS face_count
FROM objects_now
WHERE 1 + (14 - shift) % 10 <= filled
