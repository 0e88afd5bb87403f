-- How well does each policy navigate, by split alone, and by scene or category beside it (column grouped_by)?
-- Version 3.
-- Of every episode one trajectory of the policy's run counts at every success distance (is_counted); n says how many, outdated of
-- how many the episode has changed since. Means over trajectories of what the view trajectory_metrics says of each: sr (success
-- rate), el (episode length: actions, the last one included), sel (success weighted by episode length), spl (success weighted by
-- path length), arrived_share and found_share (as the view trajectory_metrics says; the latter, from _low to _high, is over the
-- looked_at trajectories whose target could be in a picture), found_spl, and curvature by two readings [rad/m]. sr_low to sr_high
-- is Wilson's interval of 95 % (Wilson 1927), spl and sel are plus or minus *_95 (1.96 standard errors; missing for n = 1); all of
-- them take trajectories as independent, which those of one scene are not quite.
WITH sums AS (
    SELECT
        policy,
        run_name,
        agent,
        split,
        success_distance_m,
        scene_id,
        category,
        CASE WHEN grouping(scene_id) = 0 THEN 'scene' WHEN grouping(category) = 0 THEN 'category' ELSE 'split' END AS grouped_by,
        count(*) AS n,
        count(DISTINCT scene_id) AS scenes,
        avg(CAST(success AS INTEGER)) AS sr,
        avg(spl) AS spl,
        1.96 * stddev_samp(spl) / sqrt(count(*)) AS spl_95,
        avg(sel) AS sel,
        1.96 * stddev_samp(sel) / sqrt(count(*)) AS sel_95,
        avg(CAST(arrived AS INTEGER)) AS arrived_share,
        avg(CAST(found AS INTEGER)) AS found_share,
        count(found) AS looked_at,
        avg(found_spl) AS found_spl,
        avg(episode_length) AS el,
        avg(episode_length) FILTER (success) AS el_success,
        avg(curvature_finite_differences_per_m) AS curvature_finite_differences_per_m,
        avg(curvature_turning_angle_per_m) AS curvature_turning_angle_per_m,
        avg(collisions) AS mean_collisions,
        avg(final_distance_m) AS final_distance_m,
        count(*) FILTER (problem IS NOT NULL) AS problems,
        count(*) FILTER (is_outdated) AS outdated
    FROM trajectory_metrics
    WHERE is_counted
    GROUP BY GROUPING SETS (
        (policy, run_name, agent, split, success_distance_m),
        (policy, run_name, agent, split, success_distance_m, scene_id),
        (policy, run_name, agent, split, success_distance_m, category)
    )
)
SELECT
    policy,
    run_name,
    agent,
    split,
    success_distance_m,
    scene_id,
    category,
    grouped_by,
    n,
    scenes,
    sr,
    CASE WHEN sr = 0 THEN 0.0 ELSE (sr + 1.9208 / n - 1.96 * sqrt(sr * (1 - sr) / n + 0.9604 / (n * n))) / (1 + 3.8416 / n) END AS sr_low,
    CASE WHEN sr = 1 THEN 1.0 ELSE (sr + 1.9208 / n + 1.96 * sqrt(sr * (1 - sr) / n + 0.9604 / (n * n))) / (1 + 3.8416 / n) END AS sr_high,
    spl,
    spl_95,
    sel,
    sel_95,
    arrived_share,
    found_share,
    CASE
        WHEN found_share = 0 THEN 0.0
        ELSE (
            found_share + 1.9208 / looked_at
            - 1.96 * sqrt(found_share * (1 - found_share) / looked_at + 0.9604 / (looked_at * looked_at))
        ) / (1 + 3.8416 / looked_at)
    END AS found_share_low,
    CASE
        WHEN found_share = 1 THEN 1.0
        ELSE (
            found_share + 1.9208 / looked_at
            + 1.96 * sqrt(found_share * (1 - found_share) / looked_at + 0.9604 / (looked_at * looked_at))
        ) / (1 + 3.8416 / looked_at)
    END AS found_share_high,
    found_spl,
    looked_at,
    el,
    el_success,
    curvature_finite_differences_per_m,
    curvature_turning_angle_per_m,
    mean_collisions,
    final_distance_m,
    problems,
    outdated
FROM sums
ORDER BY grouped_by, policy, run_name, agent, split, success_distance_m, scene_id, category
