-- What carries the objects of each scene, and does it still after the optimization?
-- Version 1.
SELECT
    scene_id,
    count(*) FILTER (relation = 'floor') AS on_floor,
    count(*) FILTER (relation = 'on') AS on_objects,
    count(*) FILTER (relation = 'inside') AS inside_objects,
    count(*) FILTER (relation = 'wall') AS on_walls,
    count(*) FILTER (relation = 'ceiling') AS on_ceiling,
    count(*) FILTER (relation = 'none') AS unsupported,
    count(against) AS against_room,
    count(*) FILTER (is_fixed) AS fixed,
    count(*) FILTER (NOT is_kept) AS lost,
    max(abs(gap_m)) AS largest_gap_m
FROM supports
GROUP BY scene_id
ORDER BY scene_id
