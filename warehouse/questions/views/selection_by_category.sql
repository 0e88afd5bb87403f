-- Of which categories do selection methods choose well?
-- Version 1.
-- Of selection_outcomes, the categories with the most instances first. top_1_without_own: candidates with the scanned model's own mesh, and
-- its crop, do not compete. regret_chamfer_m: how much worse the choice is than the best candidate. chosen_own, fallbacks: choices that are
-- the scanned model's own mesh or crop, and instances that the geometric score stood in for.
SELECT
    method,
    dataset,
    split,
    category,
    bool_or(is_held_out_category) AS is_held_out_category,
    count(*) AS examples,
    count(DISTINCT room_id) AS rooms,
    avg((truth_rank = 1)::INTEGER) AS top_1,
    avg((truth_rank <= 5)::INTEGER) AS top_5,
    avg((truth_rank_without_own = 1)::INTEGER) AS top_1_without_own,
    avg(chamfer_m) AS chamfer_m,
    avg(ecd_m) AS ecd_m,
    avg(box_iou) AS box_iou,
    avg(color_kl) AS color_kl,
    avg(chamfer_m - best_chamfer_m) AS regret_chamfer_m,
    count(*) FILTER (is_chosen_own) AS chosen_own,
    count(*) FILTER (is_fallback) AS fallbacks,
    training_id
FROM selection_outcomes
GROUP BY method, dataset, split, category, training_id
ORDER BY dataset, split, examples DESC, category, method, training_id
