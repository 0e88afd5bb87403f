-- Under which licenses are the scans and the placed assets?
SELECT
    'scan' AS material,
    coalesce(license, 'not stated') AS license,
    count(*) AS items,
    count(*) AS uses,
    count(*) AS scenes
FROM scenes
GROUP BY ALL
UNION ALL
SELECT
    'asset' AS material,
    assets.license,
    count(DISTINCT assets.asset_id) AS items,
    count(*) AS uses,
    count(DISTINCT placements.scene_id) AS scenes
FROM placements
JOIN assets USING (asset_id)
GROUP BY ALL
ORDER BY material, license
