-- Which categories stand in which kinds of room?
-- Version 1.
-- Objects of a category, and the scenes that hold one, per room type; 'unknown' where the room type is.
SELECT
    coalesce(rooms.room_type, 'unknown') AS room_type,
    counted.category,
    CAST(sum(counted.objects) AS BIGINT) AS objects,
    count(*) AS scenes
FROM (
    SELECT scene_id, category, count(*) AS objects
    FROM instances
    WHERE NOT is_structure
    GROUP BY scene_id, category
) AS counted
LEFT JOIN rooms USING (scene_id)
GROUP BY ALL
ORDER BY room_type, objects DESC, counted.category
