-- How many objects does each scene hold, and how densely?
-- Version 2.
-- room_type is the kind of the whole: of several rooms what the scan states, else 'dwelling'; each room's own is in room_overview.
-- floor_area_m2 is that of the outline, walls between rooms included.
WITH parted AS (
    SELECT scene_id, count(*) AS rooms
    FROM rooms
    GROUP BY scene_id
),
counted AS (
    SELECT
        scene_id,
        count(*) FILTER (NOT is_structure) AS objects,
        count(*) FILTER (is_structure) AS structures
    FROM instances
    GROUP BY scene_id
)
SELECT
    scene_id,
    coalesce(shells.room_type, 'unknown') AS room_type,
    coalesce(parted.rooms, 0) AS rooms,
    shells.floor_area_m2,
    coalesce(counted.objects, 0) AS objects,
    coalesce(counted.structures, 0) AS structures,
    coalesce(counted.objects, 0) / nullif(shells.floor_area_m2, 0) AS objects_per_m2
FROM scenes
LEFT JOIN shells USING (scene_id)
LEFT JOIN parted USING (scene_id)
LEFT JOIN counted USING (scene_id)
ORDER BY scene_id
