-- How well does each policy navigate, by split?
-- Version 3.
-- Of every episode one trajectory counts; the view navigation_groups says what each column is.
SELECT * EXCLUDE (grouped_by, scene_id, category)
FROM navigation_groups
WHERE grouped_by = 'split'
ORDER BY policy, run_name, agent, split, success_distance_m
