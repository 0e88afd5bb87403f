-- What kind of room is each, how large, and how much stands in it?
-- Version 1.
-- One row per room of a scene, the largest first. Objects in doorways count for the nearest room, those far from every room for none,
-- but in a scene of one room all for it. objects_per_scene counts the objects of whole scenes.
WITH parted AS (
    SELECT
        scene_id,
        room_index,
        room_type,
        floor_area_m2,
        sum(floor_area_m2) OVER (PARTITION BY scene_id) AS all_rooms_m2,
        count(*) OVER (PARTITION BY scene_id) = 1 AS is_alone
    FROM rooms
),
held AS (
    SELECT parted.scene_id, parted.room_index, count(*) AS objects, count(DISTINCT instances.category) AS categories
    FROM instances
    JOIN parted
        ON instances.scene_id = parted.scene_id AND (instances.room_index = parted.room_index OR parted.is_alone)
    WHERE NOT instances.is_structure
    GROUP BY parted.scene_id, parted.room_index
)
SELECT
    parted.scene_id,
    scenes.room_id,
    parted.room_index,
    parted.room_type,
    parted.floor_area_m2,
    parted.floor_area_m2 / nullif(parted.all_rooms_m2, 0) AS floor_share,
    coalesce(held.objects, 0) AS objects,
    coalesce(held.categories, 0) AS categories,
    coalesce(held.objects, 0) / nullif(parted.floor_area_m2, 0) AS objects_per_m2
FROM parted
LEFT JOIN scenes USING (scene_id)
LEFT JOIN held USING (scene_id, room_index)
ORDER BY parted.scene_id, parted.room_index
