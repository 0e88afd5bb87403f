-- How good are selection methods where the scanned model is known, each with its interval over rooms?
-- Version 2.
-- One row for each method, or model, that a training measured on one split of a dataset; figures and intervals of 95 % are those of
-- model_evaluations. top_1: the true candidate is chosen; top_1_without_own: the same where candidates with the scanned model's own mesh,
-- and its crop, do not compete. regret_: how much worse the choice is than the best candidate. Figures that nobody took are missing. What
-- withdrawn models reached is left out.
WITH figures AS (
    SELECT evaluations.*
    FROM model_evaluations AS evaluations
    LEFT JOIN models USING (model_id)
    WHERE coalesce(NOT models.is_withdrawn, true)
)
SELECT
    method,
    dataset,
    split,
    max(examples) FILTER (metric = 'top_1') AS instances,
    max(value) FILTER (metric = 'top_1') AS top_1,
    max(low) FILTER (metric = 'top_1') AS top_1_low,
    max(high) FILTER (metric = 'top_1') AS top_1_high,
    max(value) FILTER (metric = 'top_5') AS top_5,
    max(low) FILTER (metric = 'top_5') AS top_5_low,
    max(high) FILTER (metric = 'top_5') AS top_5_high,
    max(value) FILTER (metric = 'top_1_without_own') AS top_1_without_own,
    max(low) FILTER (metric = 'top_1_without_own') AS top_1_without_own_low,
    max(high) FILTER (metric = 'top_1_without_own') AS top_1_without_own_high,
    max(value) FILTER (metric = 'chamfer_m') AS chamfer_m,
    max(low) FILTER (metric = 'chamfer_m') AS chamfer_m_low,
    max(high) FILTER (metric = 'chamfer_m') AS chamfer_m_high,
    max(value) FILTER (metric = 'chamfer_m2') AS chamfer_m2,
    max(value) FILTER (metric = 'ecd_m') AS ecd_m,
    max(low) FILTER (metric = 'ecd_m') AS ecd_m_low,
    max(high) FILTER (metric = 'ecd_m') AS ecd_m_high,
    max(value) FILTER (metric = 'box_iou') AS box_iou,
    max(low) FILTER (metric = 'box_iou') AS box_iou_low,
    max(high) FILTER (metric = 'box_iou') AS box_iou_high,
    max(value) FILTER (metric = 'oriented_iou') AS oriented_iou,
    max(value) FILTER (metric = 'color_kl') AS color_kl,
    max(low) FILTER (metric = 'color_kl') AS color_kl_low,
    max(high) FILTER (metric = 'color_kl') AS color_kl_high,
    max(value) FILTER (metric = 'regret_chamfer_m') AS regret_chamfer_m,
    max(low) FILTER (metric = 'regret_chamfer_m') AS regret_chamfer_m_low,
    max(high) FILTER (metric = 'regret_chamfer_m') AS regret_chamfer_m_high,
    max(value) FILTER (metric = 'regret_box_iou') AS regret_box_iou,
    max(value) FILTER (metric = 'regret_color_kl') AS regret_color_kl,
    max(value) FILTER (metric = 'milliseconds') / 1000 AS seconds_per_object,
    model_id,
    training_id
FROM figures
GROUP BY method, dataset, split, model_id, training_id
HAVING count(*) FILTER (metric = 'top_1') > 0
ORDER BY dataset, split, top_1 DESC, method, model_id, training_id
