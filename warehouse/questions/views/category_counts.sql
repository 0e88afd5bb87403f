-- How often does each category occur, and in how many scenes?
-- Version 1.
-- Categories as the scans name them; the view nyu40_counts counts NYU40 classes.
WITH counted AS (
    SELECT scene_id, category, count(*) AS objects
    FROM instances
    WHERE NOT is_structure
    GROUP BY scene_id, category
)
SELECT
    category,
    CAST(sum(objects) AS BIGINT) AS objects,
    count(*) AS scenes,
    sum(objects) / sum(sum(objects)) OVER () AS share
FROM counted
GROUP BY category
ORDER BY objects DESC, category
