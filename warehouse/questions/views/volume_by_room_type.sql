-- How large are the objects in each kind of room, and how much of it do they fill?
-- Version 1.
-- Oriented boxes of the scan, of the rooms that objects stand in as in the view category_by_room_type; 'unknown' where the kind is, and
-- for objects in no room, whose floor is nobody's. room_volume_m3 is floor times the scene's height. filled_share may count space twice:
-- what is inside of others has a box of its own. solid_volume_m3: of the solids placed there (view placed_solids).
WITH kinds AS (
    SELECT
        rooms.scene_id,
        rooms.room_index,
        rooms.room_type,
        rooms.floor_area_m2,
        rooms.floor_area_m2 * shells.height_m AS room_volume_m3,
        count(*) OVER (PARTITION BY rooms.scene_id) = 1 AS is_alone
    FROM rooms
    LEFT JOIN shells USING (scene_id)
),
sized AS (
    SELECT
        room_type,
        count(*) AS rooms,
        sum(floor_area_m2) AS floor_area_m2,
        sum(room_volume_m3) AS room_volume_m3
    FROM kinds
    GROUP BY room_type
),
held AS (
    SELECT
        coalesce(kinds.room_type, 'unknown') AS room_type,
        count(*) AS objects,
        count(DISTINCT instances.scene_id) AS scenes,
        sum(instances.box_volume_m3) AS box_volume_m3,
        quantile_cont(instances.box_volume_m3, [0.0, 0.25, 0.5, 0.75, 1.0]) AS quantiles,
        count(placed_solids.instance_id) AS placed,
        sum(placed_solids.solid_volume_m3) AS solid_volume_m3
    FROM instances
    LEFT JOIN kinds
        ON instances.scene_id = kinds.scene_id AND (instances.room_index = kinds.room_index OR kinds.is_alone)
    LEFT JOIN placed_solids
        ON placed_solids.scene_id = instances.scene_id AND placed_solids.instance_id = instances.instance_id
    WHERE NOT instances.is_structure
    GROUP BY ALL
)
SELECT
    room_type,
    coalesce(sized.rooms, 0) AS rooms,
    sized.floor_area_m2,
    sized.room_volume_m3,
    coalesce(held.objects, 0) AS objects,
    coalesce(held.scenes, 0) AS scenes,
    held.quantiles[1] AS smallest_m3,
    held.quantiles[2] AS q1_m3,
    held.quantiles[3] AS median_m3,
    held.quantiles[4] AS q3_m3,
    held.quantiles[5] AS largest_m3,
    coalesce(held.box_volume_m3, 0) AS box_volume_m3,
    coalesce(held.box_volume_m3, 0) / nullif(sized.floor_area_m2, 0) AS box_m3_per_m2,
    coalesce(held.box_volume_m3, 0) / nullif(sized.room_volume_m3, 0) AS filled_share,
    coalesce(held.placed, 0) AS placed,
    coalesce(held.solid_volume_m3, 0) AS solid_volume_m3
FROM sized
FULL JOIN held USING (room_type)
ORDER BY objects DESC, room_type
