-- Which stages of which scenes failed at their last attempt, which scans were refused, and what is to be done about it?
-- Version 2.
-- Few fail at all: only what failed once is looked at in order of time. scene_id: of a refused scan, its path.
WITH suspects AS (
    SELECT DISTINCT scene_id, stage
    FROM stage_runs
    WHERE outcome NOT IN ('done', 'withdrawn')
), failed AS (
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
)
SELECT * FROM failed
UNION ALL
SELECT path, 'capture', 'refused', 'input', concat_ws(': ', nullif(field, ''), reason), 1
FROM refused_scans
ORDER BY scene_id, stage
