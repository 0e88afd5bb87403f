-- What is each object of a scene, what stands for it, and how far was that moved?
-- Version 3.
-- 'settled' is what MuJoCo says of the optimized pose. What was cut from a scan has its license (view asset_licenses).
SELECT
    instances.scene_id,
    instances.instance_id,
    instances.category,
    instances.box_size,
    instances.box_volume_m3,
    captions.materials[1] AS material,
    captions.mass_kg,
    assets.provider,
    assets.name AS asset_name,
    held.license,
    placements.origin,
    selections.score,
    selections.chamfer_m,
    placements.displacement_m,
    placements.lift_m,
    supports.relation AS support,
    supports.parent_id,
    supports.is_fixed,
    certificates.displacement_m AS settled_displacement_m,
    degrees(certificates.tilt_radians) AS settled_tilt_degrees,
    placements.remains
FROM instances
LEFT JOIN captions USING (scene_id, instance_id)
LEFT JOIN placements USING (scene_id, instance_id)
LEFT JOIN assets ON assets.asset_id = placements.asset_id
LEFT JOIN asset_licenses AS held ON held.asset_id = placements.asset_id
LEFT JOIN (
    SELECT scene_id, instance_id, asset_id, score, chamfer_m
    FROM selections
    QUALIFY row_number() OVER (PARTITION BY scene_id, instance_id, asset_id ORDER BY rank) = 1
) AS selections
    ON selections.scene_id = instances.scene_id
    AND selections.instance_id = instances.instance_id
    AND selections.asset_id = placements.asset_id
LEFT JOIN supports
    ON supports.scene_id = instances.scene_id
    AND supports.instance_id = instances.instance_id
LEFT JOIN certificates
    ON certificates.scene_id = instances.scene_id
    AND certificates.instance_id = instances.instance_id
    AND certificates.engine = 'mujoco'
WHERE NOT instances.is_structure
ORDER BY instances.scene_id, instances.instance_id
