-- Which objects are unusually small or large for their category?
-- Version 1.
-- Oriented boxes of the scan beyond the fences of the view volume_quartiles. In no order: there may be hundreds of thousands.
SELECT
    category,
    instances.scene_id,
    instances.instance_id,
    instances.box_volume_m3,
    volume_quartiles.median_m3,
    instances.box_volume_m3 / nullif(volume_quartiles.median_m3, 0) AS times_median
FROM instances
JOIN volume_quartiles USING (category)
WHERE
    NOT instances.is_structure
    AND (instances.box_volume_m3 < volume_quartiles.fence_low_m3 OR instances.box_volume_m3 > volume_quartiles.fence_high_m3)
