-- How curved is the way that each trajectory takes over the floor, in radians per metre?
-- Version 2.
-- Positions less than 1 mm from the one before are repeated and dropped (turns on the spot, blocked steps); with fewer than 3
-- left the way counts as straight, 0. curvature_finite_differences_per_m: mean of k = |x' y'' - y' x''| / (x'^2 + y'^2)^(3/2) over
-- the inner positions, x' = (x[i+1] - x[i-1]) / 2 and x'' = x[i+1] - 2 x[i] + x[i-1]; an exact way back, where x' = y' = 0, is
-- left out. curvature_turning_angle_per_m: sum of the turning angles at the inner positions over the sum of the mean lengths of the
-- two steps that meet there; a corner of 30 degrees between steps of 0.25 m gives (pi / 6) / 0.25 = 2.09 rad/m. Curvature of
-- trajectories as a measure is that of Eftekhar et al., Selective Visual Representations (ICLR 2024); its code was not
-- available, so both readings are given under names of their own.
WITH listed AS (
    SELECT batch_id, scene_id, episode_id, unnest(poses) AS pose, generate_subscripts(poses, 1) AS place
    FROM trajectories
),
moved AS (
    SELECT
        batch_id, scene_id, episode_id, place, pose[1] AS x, pose[2] AS y,
        pose[1] - lag(pose[1]) OVER way AS dx,
        pose[2] - lag(pose[2]) OVER way AS dy
    FROM listed
    WINDOW way AS (PARTITION BY batch_id, scene_id, episode_id ORDER BY place)
),
kept AS (
    SELECT *
    FROM moved
    WHERE dx IS NULL OR sqrt(dx * dx + dy * dy) >= 0.001
),
steps AS (
    SELECT
        batch_id, scene_id, episode_id,
        x - lag(x) OVER way AS before_x,
        y - lag(y) OVER way AS before_y,
        lead(x) OVER way - x AS after_x,
        lead(y) OVER way - y AS after_y
    FROM kept
    WINDOW way AS (PARTITION BY batch_id, scene_id, episode_id ORDER BY place)
),
corners AS (
    SELECT
        batch_id, scene_id, episode_id,
        (before_x + after_x) / 2 AS x1,
        (before_y + after_y) / 2 AS y1,
        after_x - before_x AS x2,
        after_y - before_y AS y2,
        abs(atan2(before_x * after_y - before_y * after_x, before_x * after_x + before_y * after_y)) AS turn,
        (sqrt(before_x * before_x + before_y * before_y) + sqrt(after_x * after_x + after_y * after_y)) / 2 AS reach
    FROM steps
    WHERE before_x IS NOT NULL AND after_x IS NOT NULL
),
curved AS (
    SELECT
        batch_id, scene_id, episode_id,
        avg(abs(x1 * y2 - y1 * x2) / power(x1 * x1 + y1 * y1, 1.5)) FILTER (sqrt(x1 * x1 + y1 * y1) > 1e-6) AS differences,
        sum(turn) / sum(reach) AS turning
    FROM corners
    GROUP BY batch_id, scene_id, episode_id
)
SELECT
    trajectories.batch_id,
    trajectories.scene_id,
    trajectories.episode_id,
    coalesce(curved.differences, 0) AS curvature_finite_differences_per_m,
    coalesce(curved.turning, 0) AS curvature_turning_angle_per_m
FROM trajectories
LEFT JOIN curved USING (batch_id, scene_id, episode_id)
ORDER BY trajectories.batch_id, trajectories.scene_id, trajectories.episode_id
