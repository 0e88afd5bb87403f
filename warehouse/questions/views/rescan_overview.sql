-- Which scans show the same room, how well do they fit, and how much changed?
-- Version 1.
-- One row per pair of scans. wall_share and object_share say how much of walls and objects lies within 10 cm of the other scan's; where
-- the outcome is refused, they fit nowhere, and nothing is counted. unsure counts what only one scan has and nobody can say of.
SELECT
    rescans.room_id,
    rescans.reference_scene_id AS from_scene,
    rescans.scene_id AS to_scene,
    rescans.outcome,
    rescans.problem,
    rescans.wall_share,
    rescans.object_share,
    count(objects.number) FILTER (WHERE objects.change = 'unchanged') AS unchanged,
    count(objects.number) FILTER (WHERE objects.change = 'moved') AS moved,
    count(objects.number) FILTER (WHERE objects.change = 'added') AS added,
    count(objects.number) FILTER (WHERE objects.change = 'removed') AS removed,
    count(objects.number) FILTER (WHERE objects.change IN ('unnamed', 'not_seen')) AS unsure
FROM rescans
LEFT JOIN rescan_objects AS objects USING (scene_id, reference_scene_id)
GROUP BY ALL
ORDER BY rescans.room_id, to_scene, from_scene
