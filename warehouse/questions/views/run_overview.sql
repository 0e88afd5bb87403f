-- When was there work on the lake, for how long, on how many machines, and what was done?
-- Version 1.
-- Runs are told by their pauses: work after all was quiet for more than ten minutes begins another one, and runs at the same time are one.
-- All attempts count, those that failed or were lost and those whose rows others replaced. worker_seconds: time that stages took, of all
-- workers; machine_seconds: from the first stage to the end of the last one on each machine, which is what machines cost (macro
-- run_costs). What is no stage, such as starting up and committing after the last stage, is not counted.
WITH executed AS (
    SELECT
        scene_id,
        outcome,
        seconds,
        host AS worker,
        regexp_replace(host, ':[0-9]+$', '') AS machine,
        started_at,
        started_at + to_microseconds(CAST(round(seconds * 1e6) AS BIGINT)) AS ended_at
    FROM stage_runs
    WHERE outcome <> 'withdrawn'
),
paused AS (
    SELECT
        *,
        max(ended_at) OVER (ORDER BY started_at, ended_at ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING) AS quiet_since
    FROM executed
),
numbered AS (
    SELECT
        *,
        count(*) FILTER (quiet_since IS NULL OR started_at > quiet_since + INTERVAL 10 MINUTE)
            OVER (ORDER BY started_at, ended_at RANGE UNBOUNDED PRECEDING) AS run_number
    FROM paused
),
on_machines AS (
    SELECT run_number, machine, epoch(max(ended_at)) - epoch(min(started_at)) AS machine_seconds
    FROM numbered
    GROUP BY run_number, machine
),
machines AS (
    SELECT run_number, count(*) AS machines, sum(machine_seconds) AS machine_seconds
    FROM on_machines
    GROUP BY run_number
),
runs AS (
    SELECT
        run_number,
        min(started_at) AS started_at,
        max(ended_at) AS ended_at,
        epoch(max(ended_at)) - epoch(min(started_at)) AS wall_seconds,
        count(DISTINCT worker) AS workers,
        sum(seconds) AS worker_seconds,
        count(*) AS stage_runs,
        count(*) FILTER (outcome = 'failed') AS failed,
        count(*) FILTER (outcome = 'lost') AS lost,
        count(DISTINCT scene_id) FILTER (contains(scene_id, '/')) AS scenes
    FROM numbered
    GROUP BY run_number
)
SELECT
    run_number,
    runs.started_at,
    runs.ended_at,
    runs.wall_seconds,
    machines.machines,
    machines.machine_seconds,
    runs.workers,
    runs.worker_seconds,
    runs.worker_seconds / nullif(runs.wall_seconds, 0) AS mean_busy_workers,
    runs.stage_runs,
    runs.failed,
    runs.lost,
    runs.scenes,
    runs.scenes * 3600 / nullif(runs.wall_seconds, 0) AS scenes_per_hour
FROM runs
JOIN machines USING (run_number)
ORDER BY run_number
