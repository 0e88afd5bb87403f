-- When did each stage of each scene run, and on which worker?
-- Version 1.
-- Runs that made the rows of today; an annotation batch stands in the place of a scene. In no order: there may be millions.
SELECT
    scene_id,
    stage,
    host,
    started_at,
    seconds,
    started_at + to_microseconds(CAST(round(seconds * 1e6) AS BIGINT)) AS ended_at
FROM current_runs
