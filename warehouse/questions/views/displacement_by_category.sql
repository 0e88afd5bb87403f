-- How far did the optimization move the objects of each category?
-- Version 1.
-- objects counts all that are placed; one of an imported dataset that states a single pose has no displacement.
SELECT
    instances.category,
    count(*) AS objects,
    count(*) FILTER (placements.displacement_m > 0) AS moved,
    quantile_cont(placements.displacement_m, 0.5) AS median_displacement_m,
    max(placements.displacement_m) AS largest_displacement_m,
    max(abs(placements.lift_m)) AS largest_lift_m
FROM placements
JOIN instances USING (scene_id, instance_id)
GROUP BY instances.category
ORDER BY objects DESC, instances.category
