-- How many categories does each scene hold, and which is the most frequent?
WITH counted AS (
    SELECT scene_id, category, count(*) AS objects
    FROM instances
    WHERE NOT is_structure
    GROUP BY scene_id, category
)
SELECT
    scenes.scene_id,
    count(counted.category) AS categories,
    first(counted.category ORDER BY counted.objects DESC, counted.category) AS most_frequent_category,
    max(counted.objects) AS most_frequent_objects
FROM scenes
LEFT JOIN counted USING (scene_id)
GROUP BY scenes.scene_id
ORDER BY scenes.scene_id
