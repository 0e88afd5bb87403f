-- How many categories does each scene hold, and which is the most frequent?
-- Version 1.
-- Of equally frequent ones the first in the order of the alphabet.
WITH counted AS (
    SELECT scene_id, category, count(*) AS objects
    FROM instances
    WHERE NOT is_structure
    GROUP BY scene_id, category
),
most AS (
    SELECT scene_id, count(*) AS categories, max(objects) AS objects
    FROM counted
    GROUP BY scene_id
),
named AS (
    SELECT scene_id, any_value(most.categories) AS categories, min(counted.category) AS category, any_value(objects) AS objects
    FROM most
    JOIN counted USING (scene_id, objects)
    GROUP BY scene_id
)
SELECT
    scene_id,
    coalesce(named.categories, 0) AS categories,
    named.category AS most_frequent_category,
    named.objects AS most_frequent_objects
FROM scenes
LEFT JOIN named USING (scene_id)
ORDER BY scene_id
