-- Under which licenses are the scan and the placed assets of each scene?
-- Version 2.
-- Asked of a release, it says under which licenses the release is. items counts different assets, uses the objects that they stand for. In
-- no order: there may be hundreds of thousands. What was cut from a scan has its license (view asset_licenses); unknown is what nobody
-- stated.
SELECT
    scene_id,
    'scan' AS material,
    stated_license(license) AS license,
    CAST(1 AS BIGINT) AS items,
    CAST(1 AS BIGINT) AS uses
FROM scenes
UNION ALL
SELECT
    used.scene_id,
    'asset' AS material,
    held.license,
    count(*) AS items,
    CAST(sum(used.uses) AS BIGINT) AS uses
FROM (
    SELECT scene_id, asset_id, count(*) AS uses
    FROM placements
    GROUP BY scene_id, asset_id
) AS used
JOIN asset_licenses AS held USING (asset_id)
GROUP BY used.scene_id, held.license
