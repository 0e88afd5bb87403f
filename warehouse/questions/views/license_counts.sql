-- Under which licenses are the scans and the placed assets?
-- Version 2.
-- items counts different scans or assets, uses the objects that they stand for; the view license_by_scene says it by scene.
-- What was cut from a scan has its license (view asset_licenses); unknown is what nobody stated.
WITH placed AS MATERIALIZED (
    SELECT asset_id, license
    FROM asset_licenses
    SEMI JOIN placements USING (asset_id)
),
by_scene AS (
    SELECT placements.scene_id, placed.license, count(*) AS uses
    FROM placements
    JOIN placed USING (asset_id)
    GROUP BY placements.scene_id, placed.license
)
SELECT
    'scan' AS material,
    stated_license(license) AS license,
    count(*) AS items,
    count(*) AS uses,
    count(*) AS scenes
FROM scenes
GROUP BY ALL
UNION ALL
SELECT
    'asset' AS material,
    license,
    items.items,
    CAST(sum(by_scene.uses) AS BIGINT) AS uses,
    count(*) AS scenes
FROM by_scene
JOIN (
    SELECT license, count(*) AS items
    FROM placed
    GROUP BY license
) AS items USING (license)
GROUP BY license, items.items
ORDER BY material, license
