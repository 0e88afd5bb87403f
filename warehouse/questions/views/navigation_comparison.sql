-- How well do policies navigate that learned from one dataset or another, in the same episodes of a third?
-- Version 2.
-- One row per comparison, choice of training datasets (trained_on) and test dataset (tested_on), over all seeds: the trajectories are those
-- that the comparison was made of (table compared_runs), and n is episodes times seeds. Measures are those of the view trajectory_metrics:
-- sr from sr_low to sr_high (Wilson's interval of 95 %, which takes trajectories as independent; those of one scene, and those of one
-- seed, are not: the view navigation_comparison_tests has tests that do without), least_sr and greatest_sr of the seeds, el (actions, the
-- last one included; el_success of the successful ones, as the paper has it), sel, spl (plus or minus *_95, 1.96 standard errors; missing
-- for n = 1), curvature by two readings [rad/m], and found_share, as the view trajectory_metrics says.
-- Comparisons with a model that was withdrawn are left out.
WITH withdrawn AS (
    SELECT DISTINCT comparison_id
    FROM compared_runs
    JOIN models USING (model_id)
    WHERE is_withdrawn
),
measured AS (
    SELECT
        compared_runs.comparison_id,
        compared_runs.trained_on,
        split_part(compared_runs.scene_id, '/', 1) AS tested_on,
        compared_runs.seed,
        models.architecture,
        trajectory_metrics.*
    FROM compared_runs
    JOIN trajectory_metrics USING (batch_id, scene_id)
    LEFT JOIN models USING (model_id)
    WHERE compared_runs.comparison_id NOT IN (SELECT comparison_id FROM withdrawn)
),
by_seed AS (
    SELECT comparison_id, trained_on, tested_on, seed, avg(CAST(success AS INTEGER)) AS sr
    FROM measured
    GROUP BY ALL
),
seeds AS (
    SELECT comparison_id, trained_on, tested_on, count(*) AS seeds, min(sr) AS least_sr, max(sr) AS greatest_sr
    FROM by_seed
    GROUP BY comparison_id, trained_on, tested_on
)
SELECT
    measured.comparison_id,
    measured.trained_on,
    measured.tested_on,
    min(measured.architecture) AS architecture,
    min(measured.success_distance_m) AS success_distance_m,
    any_value(seeds.seeds) AS seeds,
    count(DISTINCT measured.scene_id) AS scenes,
    count(DISTINCT (measured.scene_id, measured.episode_id)) AS episodes,
    count(*) AS n,
    avg(CAST(measured.success AS INTEGER)) AS sr,
    wilson_interval(count(*) FILTER (measured.success), count(*)).low AS sr_low,
    wilson_interval(count(*) FILTER (measured.success), count(*)).high AS sr_high,
    any_value(seeds.least_sr) AS least_sr,
    any_value(seeds.greatest_sr) AS greatest_sr,
    avg(measured.episode_length) AS el,
    avg(measured.episode_length) FILTER (measured.success) AS el_success,
    avg(measured.curvature_finite_differences_per_m) AS curvature_finite_differences_per_m,
    avg(measured.curvature_turning_angle_per_m) AS curvature_turning_angle_per_m,
    avg(measured.sel) AS sel,
    1.96 * stddev_samp(measured.sel) / sqrt(count(*)) AS sel_95,
    avg(measured.spl) AS spl,
    1.96 * stddev_samp(measured.spl) / sqrt(count(*)) AS spl_95,
    avg(CAST(measured.found AS INTEGER)) AS found_share,
    wilson_interval(count(*) FILTER (measured.found), count(measured.found)).low AS found_share_low,
    wilson_interval(count(*) FILTER (measured.found), count(measured.found)).high AS found_share_high
FROM measured
JOIN seeds USING (comparison_id, trained_on, tested_on)
GROUP BY measured.comparison_id, measured.trained_on, measured.tested_on
ORDER BY measured.comparison_id, measured.tested_on, measured.trained_on
