-- Which small objects belong to large ones in which kinds of room?
-- Version 1.
-- Supplementary, figure A11. Of the small objects of one category of large ones in one kind of room ('unknown' where nobody says what it
-- is), share are of the category: the rows of a room_type and large_category add up to 1. Scenes that a synthesis model drew are left out.
SELECT
    micro.room_type,
    micro.category AS large_category,
    small.category,
    count(*) AS objects,
    count(DISTINCT (micro.scene_id, micro.instance_id)) AS micro_scenes,
    count(*) / sum(count(*)) OVER (PARTITION BY micro.room_type, micro.category) AS share
FROM micro_scenes AS micro
JOIN micro_scene_objects AS small ON small.scene_id = micro.scene_id AND small.large_id = micro.instance_id
WHERE micro.scene_id NOT IN (SELECT scene_id FROM syntheses)
GROUP BY micro.room_type, micro.category, small.category
ORDER BY micro.room_type, large_category, objects DESC, small.category
