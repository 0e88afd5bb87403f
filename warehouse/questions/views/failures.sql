-- Which stages of which scenes failed at their last attempt, and what is to be done about it?
-- Version 1.
-- Few fail at all: only what failed once is looked at in order of time.
WITH suspects AS (
    SELECT DISTINCT scene_id, stage
    FROM stage_runs
    WHERE outcome NOT IN ('done', 'withdrawn')
)
SELECT
    scene_id,
    stage,
    outcome,
    error_kind,
    error,
    count(*) OVER (PARTITION BY scene_id, stage, fingerprint) AS attempts
FROM stage_runs
SEMI JOIN suspects USING (scene_id, stage)
WHERE outcome <> 'withdrawn'
QUALIFY row_number() OVER (
    PARTITION BY scene_id, stage
    ORDER BY snapshot_id DESC, started_at DESC, fingerprint DESC, attempt DESC
) = 1 AND outcome <> 'done'
ORDER BY scene_id, stage
