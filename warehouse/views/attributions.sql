-- Whom do the placed assets come from, and under which license?
-- Version 1.
-- LicenseRef-scan stands for the license of the scan that an asset was cut from (assets.source).
WITH used AS (
    SELECT asset_id, count(*) AS uses
    FROM placements
    GROUP BY asset_id
)
SELECT
    assets.license,
    coalesce(assets.author, 'unknown') AS author,
    assets.provider,
    assets.source,
    count(*) AS assets,
    CAST(sum(used.uses) AS BIGINT) AS uses
FROM used
JOIN assets USING (asset_id)
GROUP BY ALL
ORDER BY assets.license, author, assets.provider, assets.source
