-- Under which licenses are the scans and the placed assets?
-- Version 1.
-- items counts different scans or assets, uses the objects that they stand for; the view license_by_scene says it by scene.
WITH used AS (
    SELECT asset_id, count(*) AS uses
    FROM placements
    GROUP BY asset_id
),
items AS (
    SELECT assets.license, count(*) AS items
    FROM used
    JOIN assets USING (asset_id)
    GROUP BY assets.license
)
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
    license,
    any_value(items.items) AS items,
    CAST(sum(by_scene.uses) AS BIGINT) AS uses,
    count(*) AS scenes
FROM license_by_scene AS by_scene
JOIN items USING (license)
WHERE by_scene.material = 'asset'
GROUP BY license
ORDER BY material, license
