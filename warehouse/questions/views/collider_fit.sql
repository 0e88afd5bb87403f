-- Of which assets do the convex pieces fill openings, or leave parts out?
-- Version 1.
-- Placed assets of whose rays more than 2 % stop early (early_share) or miss (miss_share), the worst first; placements says how both are
-- measured. Objects are those that an asset stands for. Finished datasets that say nothing of pieces are left out.
SELECT
    placements.asset_id,
    any_value(assets.name) AS name,
    any_value(assets.category) AS category,
    any_value(assets.provider) AS provider,
    count(*) AS objects,
    max(placements.collider_early_share) AS early_share,
    max(placements.collider_miss_share) AS miss_share,
    max(placements.collider_pieces) AS pieces,
    max(placements.collider_faces) AS faces
FROM placements
LEFT JOIN assets USING (asset_id)
WHERE greatest(placements.collider_early_share, placements.collider_miss_share) > 0.02
GROUP BY placements.asset_id
ORDER BY greatest(max(placements.collider_early_share), max(placements.collider_miss_share)) DESC, placements.asset_id
