-- Which run of each stage made the rows that a scene has now?
-- Of every fingerprint its newest run counts; one that was withdrawn since made nothing that is still there.
WITH newest_of_fingerprint AS (
    SELECT *
    FROM stage_runs
    WHERE outcome IN ('done', 'withdrawn')
    QUALIFY row_number() OVER (
        PARTITION BY scene_id, stage, fingerprint
        ORDER BY snapshot_id DESC, attempt DESC, started_at DESC, outcome
    ) = 1
)
SELECT *
FROM newest_of_fingerprint
WHERE outcome = 'done'
QUALIFY row_number() OVER (
    PARTITION BY scene_id, stage
    ORDER BY snapshot_id DESC, started_at DESC, attempt DESC, fingerprint
) = 1
ORDER BY scene_id, stage
