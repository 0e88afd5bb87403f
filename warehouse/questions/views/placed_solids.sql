-- How large is the solid of each placed object?
-- Version 1.
-- Volume of the asset's solid (of its convex hull, when the mesh is not closed) times the three factors of its scale. In no order.
SELECT
    placements.scene_id,
    placements.instance_id,
    instances.category,
    placements.asset_id,
    assets.volume_m3 * placements.scale[1] * placements.scale[2] * placements.scale[3] AS solid_volume_m3
FROM placements
JOIN instances USING (scene_id, instance_id)
JOIN assets USING (asset_id)
WHERE NOT instances.is_structure
