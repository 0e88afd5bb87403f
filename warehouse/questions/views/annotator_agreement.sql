-- How often do two annotators choose the same for the same instance, and how much more often than by chance?
-- Version 1.
-- Of each annotator the answer that counts (view current_answers); 'none fits' is a choice like any other. agreement is the share of equal
-- choices. cohens_kappa (Cohen 1960) is (agreement - chance) / (1 - chance), with chance from how often either annotator takes which slot
-- (the lowest that holds the asset; an asset that is no candidate any more stands for itself): 1 is full agreement, 0 what chance gives,
-- missing where chance alone would agree always. Instances that were numbered anew since are not told apart.
WITH labeled AS (
    SELECT
        answers.scene_id,
        answers.instance_id,
        answers.annotator,
        CASE
            WHEN answers.choice IS NULL THEN 'none'
            ELSE coalesce(CAST(min(candidates.slot) AS VARCHAR), answers.choice)
        END AS label
    FROM current_answers AS answers
    LEFT JOIN candidates
        ON candidates.scene_id = answers.scene_id
        AND candidates.instance_id = answers.instance_id
        AND candidates.asset_id = answers.choice
    GROUP BY answers.scene_id, answers.instance_id, answers.annotator, answers.choice
),
pairs AS (
    SELECT
        a.annotator AS annotator_a,
        b.annotator AS annotator_b,
        a.label AS label_a,
        b.label AS label_b,
        count(*) AS instances
    FROM labeled AS a
    JOIN labeled AS b USING (scene_id, instance_id)
    WHERE a.annotator < b.annotator
    GROUP BY ALL
),
totals AS (
    SELECT
        annotator_a,
        annotator_b,
        CAST(sum(instances) AS BIGINT) AS instances,
        CAST(coalesce(sum(instances) FILTER (label_a = label_b), 0) AS BIGINT) AS same_choice,
        CAST(coalesce(sum(instances) FILTER (label_a = 'none' AND label_b = 'none'), 0) AS BIGINT) AS both_none_fits
    FROM pairs
    GROUP BY annotator_a, annotator_b
),
taken_a AS (
    SELECT annotator_a, annotator_b, label_a AS label, sum(instances) AS times_a
    FROM pairs
    GROUP BY ALL
),
taken_b AS (
    SELECT annotator_a, annotator_b, label_b AS label, sum(instances) AS times_b
    FROM pairs
    GROUP BY ALL
),
chances AS (
    SELECT annotator_a, annotator_b, CAST(sum(times_a * times_b) AS DOUBLE) AS coincidences
    FROM taken_a
    JOIN taken_b USING (annotator_a, annotator_b, label)
    GROUP BY annotator_a, annotator_b
)
SELECT
    annotator_a,
    annotator_b,
    totals.instances,
    totals.same_choice,
    totals.both_none_fits,
    totals.same_choice / totals.instances AS agreement,
    coalesce(chances.coincidences, 0) / (totals.instances * totals.instances) AS chance_agreement,
    (totals.same_choice * totals.instances - coalesce(chances.coincidences, 0))
        / nullif(totals.instances * totals.instances - coalesce(chances.coincidences, 0), 0) AS cohens_kappa
FROM totals
LEFT JOIN chances USING (annotator_a, annotator_b)
ORDER BY annotator_a, annotator_b
