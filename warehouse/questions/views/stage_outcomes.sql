-- How often was each stage run, and what came of it?
-- Version 1.
SELECT
    stage,
    count(*) FILTER (outcome <> 'withdrawn') AS runs,
    count(*) FILTER (outcome = 'done') AS done,
    count(*) FILTER (outcome = 'failed') AS failed,
    count(*) FILTER (outcome = 'lost') AS lost,
    count(*) FILTER (outcome = 'withdrawn') AS withdrawn,
    coalesce(sum(seconds) FILTER (outcome <> 'withdrawn'), 0) AS total_seconds
FROM stage_runs
GROUP BY stage
ORDER BY stage
