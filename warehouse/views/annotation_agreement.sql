-- How often did people choose what the selection had ranked first?
WITH newest AS (
    SELECT *
    FROM annotations
    QUALIFY row_number() OVER (
        PARTITION BY scene_id, instance_id, annotator ORDER BY answered_at DESC, batch_id DESC
    ) = 1
)
SELECT
    newest.annotator,
    count(*) AS answers,
    count(*) FILTER (newest.choice IS NULL) AS none_fits,
    count(*) FILTER (newest.choice = selections.asset_id) AS same_as_selection,
    count(*) FILTER (newest.choice = selections.asset_id)
        / nullif(count(*) FILTER (newest.choice IS NOT NULL AND selections.asset_id IS NOT NULL), 0) AS agreement
FROM newest
LEFT JOIN selections
    ON selections.scene_id = newest.scene_id
    AND selections.instance_id = newest.instance_id
    AND selections.rank = 1
GROUP BY newest.annotator
ORDER BY newest.annotator
