-- Whom do the placed assets come from, and under which license?
SELECT
    assets.license,
    coalesce(assets.author, 'unknown') AS author,
    assets.provider,
    assets.source,
    count(DISTINCT assets.asset_id) AS assets,
    count(*) AS uses
FROM placements
JOIN assets USING (asset_id)
GROUP BY ALL
ORDER BY assets.license, author, assets.provider, assets.source
