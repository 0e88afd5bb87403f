-- Which run of each stage made the rows that a scene has now?
-- Version 1.
-- The newest that was done; none when its rows were withdrawn since.
SELECT *
FROM (
    SELECT *
    FROM stage_runs
    WHERE outcome IN ('done', 'withdrawn')
    QUALIFY row_number() OVER (
        PARTITION BY scene_id, stage
        ORDER BY snapshot_id DESC, started_at DESC, fingerprint DESC, attempt DESC
    ) = 1
)
WHERE outcome = 'done'
ORDER BY scene_id, stage
