-- How many objects does each scene hold, and how densely?
SELECT
    scenes.scene_id,
    coalesce(any_value(rooms.room_type), 'unknown') AS room_type,
    any_value(rooms.floor_area_m2) AS floor_area_m2,
    count(instances.instance_id) FILTER (NOT instances.is_structure) AS objects,
    count(instances.instance_id) FILTER (instances.is_structure) AS structures,
    count(instances.instance_id) FILTER (NOT instances.is_structure) / nullif(any_value(rooms.floor_area_m2), 0) AS objects_per_m2
FROM scenes
LEFT JOIN rooms USING (scene_id)
LEFT JOIN instances USING (scene_id)
GROUP BY scenes.scene_id
ORDER BY scenes.scene_id
