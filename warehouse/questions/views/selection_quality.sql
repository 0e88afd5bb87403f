-- How well does the selected candidate fit, per category?
-- Version 1.
SELECT
    instances.category,
    count(*) AS objects,
    quantile_cont(selections.score, 0.5) AS median_score,
    min(selections.score) AS lowest_score,
    quantile_cont(selections.chamfer_m, 0.5) AS median_chamfer_m,
    quantile_cont(selections.coverage, 0.5) AS median_coverage,
    quantile_cont(selections.box_iou, 0.5) AS median_box_iou
FROM selections
JOIN instances USING (scene_id, instance_id)
WHERE selections.rank = 1
GROUP BY instances.category
ORDER BY objects DESC, instances.category
