-- Which objects are unusually small or large for their category?
SELECT
    instances.category,
    instances.scene_id,
    instances.instance_id,
    instances.box_volume_m3,
    boxes.median_m3,
    instances.box_volume_m3 / nullif(boxes.median_m3, 0) AS times_median
FROM instances
JOIN volume_by_category AS boxes USING (category)
WHERE
    NOT instances.is_structure
    AND (instances.box_volume_m3 < boxes.whisker_low_m3 OR instances.box_volume_m3 > boxes.whisker_high_m3)
ORDER BY instances.category, instances.box_volume_m3, instances.scene_id, instances.instance_id
