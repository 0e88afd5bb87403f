-- Which categories stand in which kinds of room?
-- Version 2.
-- Objects of a category, and the scenes that hold one there, by the kind of the room that each object stands in; 'unknown' where that
-- is, and for objects in no room. In a scene of one room all objects are in it.
SELECT
    coalesce(kinds.room_type, 'unknown') AS room_type,
    counted.category,
    CAST(sum(counted.objects) AS BIGINT) AS objects,
    count(DISTINCT counted.scene_id) AS scenes
FROM (
    SELECT scene_id, room_index, category, count(*) AS objects
    FROM instances
    WHERE NOT is_structure
    GROUP BY scene_id, room_index, category
) AS counted
LEFT JOIN (
    SELECT scene_id, room_index, room_type, count(*) OVER (PARTITION BY scene_id) = 1 AS is_alone
    FROM rooms
) AS kinds
    ON counted.scene_id = kinds.scene_id AND (counted.room_index = kinds.room_index OR kinds.is_alone)
GROUP BY ALL
ORDER BY room_type, objects DESC, counted.category
