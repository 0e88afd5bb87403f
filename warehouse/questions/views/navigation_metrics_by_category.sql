-- How well does each policy find targets of each category, by split?
-- Version 3.
-- Of every episode one trajectory counts; the view navigation_groups says what each column is.
SELECT * EXCLUDE (grouped_by, scene_id)
FROM navigation_groups
WHERE grouped_by = 'category'
ORDER BY policy, run_name, agent, split, success_distance_m, category
