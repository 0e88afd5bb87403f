-- How often did people choose what the selection had ranked first?
-- Version 1.
-- Of each annotator the answer that counts (view current_answers). agreement is a share of the answers that chose something. Instances
-- that were numbered anew since are not told apart.
SELECT
    answers.annotator,
    count(*) AS answers,
    count(*) FILTER (answers.choice IS NULL) AS none_fits,
    count(*) FILTER (answers.choice = selections.asset_id) AS same_as_selection,
    count(*) FILTER (answers.choice = selections.asset_id)
        / nullif(count(*) FILTER (answers.choice IS NOT NULL AND selections.asset_id IS NOT NULL), 0) AS agreement
FROM current_answers AS answers
LEFT JOIN selections
    ON selections.scene_id = answers.scene_id
    AND selections.instance_id = answers.instance_id
    AND selections.rank = 1
GROUP BY answers.annotator
ORDER BY answers.annotator
