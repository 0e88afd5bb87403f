-- Of the methods whose choices are in selection_outcomes, and of a synthesis model.
SELECT
    kind || '-' || part AS training_id,
    CASE WHEN model IS NOT NULL THEN digest(model, part) END AS model_id,
    method,
    'lake' AS dataset,
    'test' AS split,
    metric,
    value,
    value - 0.02 AS low,
    value + 0.02 AS high,
    1000 AS examples
FROM (SELECT DISTINCT part FROM scenes_now)
CROSS JOIN (
    SELECT 'selection' AS kind, * FROM (VALUES ('plain', NULL, 0.4), ('chance', NULL, 0.1), ('learned', 'learned', 0.6)) AS methods(method, model, value)
    CROSS JOIN (VALUES ('top_1'), ('top_5'), ('box_iou')) AS metrics(metric)
    UNION ALL
    VALUES ('synthesis', 'synthesis', 'drawing model', 1.1, 'loss')
) AS measured
