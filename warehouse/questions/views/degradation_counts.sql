-- What had to be left out or done by a fallback, how often and in how many scenes?
-- Version 2.
-- A leading instance id is dropped, so that equal degradations of different objects are counted together. scenes counts none for what is
-- said of a batch of trajectories or annotations.
SELECT
    stage,
    regexp_replace(degradation, '^[0-9]{4,}: ', '') AS degradation,
    count(*) AS times,
    count(DISTINCT scene_id) FILTER (contains(scene_id, '/')) AS scenes
FROM (SELECT stage, scene_id, unnest(degradations) AS degradation FROM current_runs)
GROUP BY ALL
ORDER BY stage, times DESC, degradation
