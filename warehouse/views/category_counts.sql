-- How often does each category occur, and in how many scenes?
SELECT
    category,
    count(*) AS objects,
    count(DISTINCT scene_id) AS scenes,
    count(*) / sum(count(*)) OVER () AS share
FROM instances
WHERE NOT is_structure
GROUP BY category
ORDER BY objects DESC, category
