-- Under which licenses are the scan and the placed assets of each scene?
-- Version 1.
-- Asked of a release, it says under which licenses the release is. items counts different assets, uses the objects that they stand for. In
-- no order: there may be hundreds of thousands. LicenseRef-scan stands for the license of the scan that an asset was cut from
-- (assets.source).
SELECT
    scene_id,
    'scan' AS material,
    coalesce(license, 'not stated') AS license,
    CAST(1 AS BIGINT) AS items,
    CAST(1 AS BIGINT) AS uses
FROM scenes
UNION ALL
SELECT
    used.scene_id,
    'asset' AS material,
    assets.license,
    count(*) AS items,
    CAST(sum(used.uses) AS BIGINT) AS uses
FROM (
    SELECT scene_id, asset_id, count(*) AS uses
    FROM placements
    GROUP BY scene_id, asset_id
) AS used
JOIN assets USING (asset_id)
GROUP BY used.scene_id, assets.license
