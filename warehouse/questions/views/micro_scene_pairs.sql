-- Which small objects belong to which large ones?
-- Version 1.
-- Supplementary, figure A10. objects of a small category that belong to large ones of a category, through others too, and the micro-scenes
-- that hold at least one. object_share is of all small objects of that large category, micro_scene_share of its micro-scenes. Scenes that
-- a synthesis model drew are left out.
WITH scanned AS (
    SELECT micro.category AS large_category, small.category, micro.scene_id, micro.instance_id
    FROM micro_scenes AS micro
    JOIN micro_scene_objects AS small ON small.scene_id = micro.scene_id AND small.large_id = micro.instance_id
    WHERE micro.scene_id NOT IN (SELECT scene_id FROM syntheses)
),
totals AS (
    SELECT large_category, count(*) AS objects, count(DISTINCT (scene_id, instance_id)) AS micro_scenes
    FROM scanned
    GROUP BY large_category
)
SELECT
    scanned.large_category,
    scanned.category,
    count(*) AS objects,
    count(DISTINCT (scanned.scene_id, scanned.instance_id)) AS micro_scenes,
    count(*) / any_value(totals.objects) AS object_share,
    count(DISTINCT (scanned.scene_id, scanned.instance_id)) / any_value(totals.micro_scenes) AS micro_scene_share
FROM scanned
JOIN totals USING (large_category)
GROUP BY scanned.large_category, scanned.category
ORDER BY objects DESC, scanned.large_category, scanned.category
