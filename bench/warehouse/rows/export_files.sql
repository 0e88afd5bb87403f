SELECT
    scene_id,
    format,
    CASE file WHEN 0 THEN concat(stem, '/scene.', format) ELSE concat(stem, '/parts/', name_of(file), '.bin') END AS path,
    digest('file ' || format || file, scene) || CASE file WHEN 0 THEN '.' || left(format, 8) ELSE '.bin' END AS file_blob,
    CASE file WHEN 0 THEN 200000 ELSE 1000 END + below(scene * 100 + file, 'size ' || format, 50000) AS size_bytes,
    CASE WHEN file = 0 THEN 'scene' WHEN file < 3 THEN 'stage' WHEN file < 5 THEN 'collision' ELSE 'asset' END AS role,
    NOT is_broken(scene, format) AS passed
FROM (
    SELECT *, format || '/' || replace(scene_id, '/', '_') AS stem, (step + 1) % 8 AS file
    FROM (
        SELECT *, unnest(range(8)) AS step
        FROM (SELECT *, unnest(getvariable('formats')) AS format FROM scenes_now)
    )
)
