-- How often does each NYU40 class occur, in how many scenes, and under how many names?
-- Version 1.
-- Class 0, 'unlabeled', holds the categories that the label map knows no class of.
WITH counted AS (
    SELECT scene_id, nyu40_id, count(*) AS objects
    FROM instances
    WHERE NOT is_structure
    GROUP BY scene_id, nyu40_id
),
named AS (
    SELECT nyu40_id, min(nyu40_label) AS nyu40_label, count(*) AS categories
    FROM (
        SELECT nyu40_id, category, min(nyu40_label) AS nyu40_label
        FROM instances
        WHERE NOT is_structure
        GROUP BY nyu40_id, category
    )
    GROUP BY nyu40_id
)
SELECT
    nyu40_id,
    any_value(named.nyu40_label) AS nyu40_label,
    CAST(sum(counted.objects) AS BIGINT) AS objects,
    count(*) AS scenes,
    any_value(named.categories) AS categories,
    sum(counted.objects) / sum(sum(counted.objects)) OVER () AS share
FROM counted
JOIN named USING (nyu40_id)
GROUP BY nyu40_id
ORDER BY objects DESC, nyu40_id
