-- Whom do the placed assets come from, and under which license?
-- Version 2.
-- What was cut from a scan has its license (view asset_licenses).
WITH used AS (
    SELECT asset_id, count(*) AS uses
    FROM placements
    GROUP BY asset_id
)
SELECT
    held.license,
    coalesce(assets.author, 'unknown') AS author,
    assets.provider,
    assets.source,
    count(*) AS assets,
    CAST(sum(used.uses) AS BIGINT) AS uses
FROM used
JOIN assets USING (asset_id)
JOIN asset_licenses AS held USING (asset_id)
GROUP BY ALL
ORDER BY held.license, author, assets.provider, assets.source
