-- How many objects does each scene hold, and how densely?
-- Version 1.
WITH counted AS (
    SELECT
        scene_id,
        count(*) FILTER (NOT is_structure) AS objects,
        count(*) FILTER (is_structure) AS structures
    FROM instances
    GROUP BY scene_id
)
SELECT
    scene_id,
    coalesce(rooms.room_type, 'unknown') AS room_type,
    rooms.floor_area_m2,
    coalesce(counted.objects, 0) AS objects,
    coalesce(counted.structures, 0) AS structures,
    coalesce(counted.objects, 0) / nullif(rooms.floor_area_m2, 0) AS objects_per_m2
FROM scenes
LEFT JOIN rooms USING (scene_id)
LEFT JOIN counted USING (scene_id)
ORDER BY scene_id
