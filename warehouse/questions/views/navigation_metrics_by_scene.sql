-- How well does each policy navigate in each scene?
-- Version 3.
-- Of every episode one trajectory counts; the view navigation_groups says what each column is.
SELECT * EXCLUDE (grouped_by, category, scenes)
FROM navigation_groups
WHERE grouped_by = 'scene'
ORDER BY policy, run_name, agent, split, success_distance_m, scene_id
