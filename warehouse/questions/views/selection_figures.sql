-- How good are the choices of selection methods, for categories that were learned from and for those that were held out?
-- Version 1.
-- Of selection_outcomes. categories: all, known (instances of it were learned from) or held out. low and high: the mean's interval of 95 %,
-- from how much rooms differ (linearized; missing for a single room). Rows of several seeds count as so many instances of their rooms.
WITH grouped AS (
    SELECT *, unnest(['all', CASE WHEN is_held_out_category THEN 'held out' ELSE 'known' END]) AS categories
    FROM selection_outcomes
),
measured AS (
    SELECT
        training_id, method, dataset, split, categories, room_id,
        unnest([
            {'metric': 'top_1', 'value': (truth_rank = 1)::DOUBLE},
            {'metric': 'top_5', 'value': (truth_rank <= 5)::DOUBLE},
            {'metric': 'top_1_without_own', 'value': (truth_rank_without_own = 1)::DOUBLE},
            {'metric': 'top_5_without_own', 'value': (truth_rank_without_own <= 5)::DOUBLE},
            {'metric': 'chamfer_m', 'value': chamfer_m},
            {'metric': 'chamfer_m2', 'value': chamfer_m2},
            {'metric': 'ecd_m', 'value': ecd_m},
            {'metric': 'box_iou', 'value': box_iou},
            {'metric': 'oriented_iou', 'value': oriented_iou},
            {'metric': 'color_kl', 'value': color_kl},
            {'metric': 'regret_chamfer_m', 'value': abs(chamfer_m - best_chamfer_m)},
            {'metric': 'regret_chamfer_m2', 'value': abs(chamfer_m2 - best_chamfer_m2)},
            {'metric': 'regret_ecd_m', 'value': abs(ecd_m - best_ecd_m)},
            {'metric': 'regret_box_iou', 'value': abs(box_iou - best_box_iou)},
            {'metric': 'regret_oriented_iou', 'value': abs(oriented_iou - best_oriented_iou)},
            {'metric': 'regret_color_kl', 'value': abs(color_kl - best_color_kl)},
            {'metric': 'milliseconds', 'value': milliseconds}
        ]) AS figure
    FROM grouped
),
by_room AS (
    SELECT
        training_id, method, dataset, split, categories, figure.metric AS metric, room_id,
        sum(figure.value) AS total, count(*) AS examples
    FROM measured
    WHERE figure.value IS NOT NULL
    GROUP BY ALL
),
means AS (
    SELECT *, sum(total) OVER groups / sum(examples) OVER groups AS mean, sum(examples) OVER groups AS all_examples
    FROM by_room
    WINDOW groups AS (PARTITION BY training_id, method, dataset, split, categories, metric)
),
spread AS (
    SELECT
        training_id, method, dataset, split, categories, metric,
        any_value(mean) AS value,
        any_value(all_examples)::BIGINT AS examples,
        count(*) AS rooms,
        CASE
            WHEN count(*) > 1
            THEN 1.959964 * sqrt(sum((total - mean * examples) ** 2) * count(*) / (count(*) - 1)) / any_value(all_examples)
        END AS reach
    FROM means
    GROUP BY training_id, method, dataset, split, categories, metric
)
SELECT method, dataset, split, categories, metric, value, value - reach AS low, value + reach AS high, examples, rooms, training_id
FROM spread
ORDER BY dataset, split, categories, metric, method, training_id
