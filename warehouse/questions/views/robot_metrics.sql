-- How well do carts drive the ways of each policy?
-- Version 2.
-- setup: what of the settings was not as by default. Of every episode the newest run counts (current_robot_runs); means are of runs that
-- moved. arrived_share: of carts that ended where their way ends, from _low to _high (Wilson 1927, 95 %; it takes runs as
-- independent, which those of one scene are not quite); stuck, timeout, collided, unreachable: how many ended so. collisions: times that
-- carts ran into something. least_clearance_m: least distance to an obstacle of all. error_m: mean over runs of the mean distance of
-- truth and where the cart believed to be; wheels_error_m, wheels_gyro_error_m, final_error_m: root mean square, over runs, of the
-- distance at the end with wheels alone, with the gyro besides, and with all three; with_moved: runs in which something stood elsewhere
-- than on the map. nees: mean normalized estimation error squared of the pose; 3 where the filter knows how good it is (Bar-Shalom, Li
-- and Kirubarajan 2001).
SELECT
    policy,
    run_name,
    setup,
    body,
    count(*) AS n,
    count(DISTINCT scene_id) AS scenes,
    count(*) FILTER (outcome = 'arrived') / count(*) AS arrived_share,
    wilson_interval(count(*) FILTER (outcome = 'arrived'), count(*)).low AS arrived_share_low,
    wilson_interval(count(*) FILTER (outcome = 'arrived'), count(*)).high AS arrived_share_high,
    count(*) FILTER (outcome = 'stuck') AS stuck,
    count(*) FILTER (outcome = 'timeout') AS timeout,
    count(*) FILTER (outcome = 'collided') AS collided,
    count(*) FILTER (outcome = 'unreachable') AS unreachable,
    CAST(sum(collisions) AS BIGINT) AS collisions,
    min(least_clearance_m) FILTER (seconds > 0) AS least_clearance_m,
    avg(error_m) FILTER (seconds > 0) AS error_m,
    max(greatest_error_m) AS greatest_error_m,
    degrees(avg(heading_error_radians) FILTER (seconds > 0)) AS heading_error_degrees,
    sqrt(avg(wheels_error_m * wheels_error_m) FILTER (seconds > 0)) AS wheels_error_m,
    sqrt(avg(wheels_gyro_error_m * wheels_gyro_error_m) FILTER (seconds > 0)) AS wheels_gyro_error_m,
    sqrt(avg(final_error_m * final_error_m) FILTER (seconds > 0)) AS final_error_m,
    avg(nees) FILTER (seconds > 0) AS nees,
    avg(seconds) FILTER (seconds > 0) AS seconds,
    avg(travelled_m) FILTER (seconds > 0) AS travelled_m,
    avg(recoveries) AS mean_recoveries,
    count(*) FILTER (len(moved) > 0) AS with_moved,
    sum(scans_used) / nullif(sum(scans), 0) AS scans_used_share,
    avg(decision_seconds) FILTER (seconds > 0) AS decision_seconds,
    max(slowest_decision_seconds) AS slowest_decision_seconds
FROM current_robot_runs
GROUP BY policy, run_name, setup, body
ORDER BY policy, run_name, setup, body
