-- How are micro-scenes parted into train and test?
-- Version 1.
-- By physical room, so that no rescan of a room is on the other side: the shares of rooms are those that 4:1 speaks of, of rooms that hold
-- a micro-scene. split is missing for rooms that have none. Scenes that a synthesis model drew are left out.
WITH counted AS (
    SELECT scene_id, large_id AS instance_id, count(*) AS objects
    FROM micro_scene_objects
    GROUP BY scene_id, large_id
)
SELECT
    splits.split,
    count(*) AS micro_scenes,
    count(DISTINCT micro.room_id) AS rooms,
    CAST(sum(counted.objects) AS BIGINT) AS objects,
    count(*) / sum(count(*)) OVER () AS micro_scene_share,
    count(DISTINCT micro.room_id) / sum(count(DISTINCT micro.room_id)) OVER () AS room_share,
    sum(counted.objects) / sum(sum(counted.objects)) OVER () AS object_share
FROM micro_scenes AS micro
JOIN counted USING (scene_id, instance_id)
LEFT JOIN splits USING (room_id)
WHERE micro.scene_id NOT IN (SELECT scene_id FROM syntheses)
GROUP BY splits.split
ORDER BY splits.split NULLS LAST
