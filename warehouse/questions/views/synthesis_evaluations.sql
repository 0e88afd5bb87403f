-- How good are synthesis models on large objects that they did not learn from, beside what they are held against?
-- Version 1.
-- Figures of model_evaluations by trainings whose models are synthesis models, methods that learn nothing included: one row per method,
-- split and metric, with its interval of 95 %. architecture is missing for a method that learns nothing. What withdrawn models reached is
-- left out.
SELECT
    evaluations.method,
    models.architecture,
    evaluations.dataset,
    evaluations.split,
    evaluations.metric,
    evaluations.value,
    evaluations.low,
    evaluations.high,
    evaluations.examples,
    evaluations.model_id,
    evaluations.training_id
FROM model_evaluations AS evaluations
LEFT JOIN models USING (model_id)
WHERE
    evaluations.training_id IN (SELECT training_id FROM models WHERE kind = 'synthesis')
    AND coalesce(NOT models.is_withdrawn, true)
ORDER BY evaluations.dataset, evaluations.split, evaluations.metric, evaluations.training_id, evaluations.method
