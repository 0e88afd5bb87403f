-- How many micro-scenes of each kind of large object are there, in which rooms, and how much stands on them?
-- Version 1.
-- A micro-scene is a large object with all small ones that belong to it, through others too. One row per category of large objects and
-- kind of room, and one with room_type 'all'. rooms counts physical rooms. Shares are of the small objects: chained_share of those that
-- another small one carries, inside_share of those in a compartment or container, leaning_share of those that lean. Scenes that a
-- synthesis model drew are left out: the view synthesis_figures counts them.
WITH counted AS (
    SELECT
        scene_id,
        large_id AS instance_id,
        count(*) AS objects,
        count(*) FILTER (depth > 1) AS chained,
        count(*) FILTER (relation = 'inside') AS inside,
        count(*) FILTER (relation = 'leans') AS leaning,
        max(depth) AS longest_chain
    FROM micro_scene_objects
    GROUP BY scene_id, large_id
)
SELECT
    micro.category,
    CASE WHEN grouping(micro.room_type) = 1 THEN 'all' ELSE micro.room_type END AS room_type,
    count(*) AS micro_scenes,
    count(DISTINCT micro.room_id) AS rooms,
    CAST(sum(counted.objects) AS BIGINT) AS objects,
    avg(counted.objects) AS mean_objects,
    quantile_cont(counted.objects, 0.5) AS median_objects,
    max(counted.objects) AS max_objects,
    sum(counted.chained) / sum(counted.objects) AS chained_share,
    sum(counted.inside) / sum(counted.objects) AS inside_share,
    sum(counted.leaning) / sum(counted.objects) AS leaning_share,
    max(counted.longest_chain) AS longest_chain
FROM micro_scenes AS micro
JOIN counted USING (scene_id, instance_id)
WHERE micro.scene_id NOT IN (SELECT scene_id FROM syntheses)
GROUP BY GROUPING SETS ((micro.category, micro.room_type), (micro.category))
ORDER BY max(count(*)) OVER (PARTITION BY micro.category) DESC, micro.category, grouping(micro.room_type) DESC, micro_scenes DESC, room_type
