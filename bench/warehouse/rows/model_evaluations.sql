-- Of the methods whose choices are in selection_outcomes.
SELECT
    'selection-' || part AS training_id,
    CASE method WHEN 'learned' THEN digest('learned', part) END AS model_id,
    method,
    'lake' AS dataset,
    'test' AS split,
    metric,
    value,
    value - 0.02 AS low,
    value + 0.02 AS high,
    1000 AS examples
FROM (SELECT DISTINCT part FROM scenes_now)
CROSS JOIN (VALUES ('plain', 0.4), ('chance', 0.1), ('learned', 0.6)) AS methods(method, value)
CROSS JOIN (VALUES ('top_1'), ('top_5'), ('box_iou')) AS metrics(metric)
