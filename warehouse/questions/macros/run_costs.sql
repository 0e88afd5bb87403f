-- What did each run cost, at so much for an hour of a machine?
-- Version 1.
-- Rows of the view run_overview with their cost: hours of machines times the price, which may be in another currency as well; costs are in
-- that of the price. Calls to models are not in it (view model_call_costs).
-- Example: FROM run_costs(1.25)
CREATE MACRO run_costs(price_usd_per_hour) AS TABLE
SELECT
    run_number,
    started_at,
    wall_seconds,
    machines,
    machine_seconds,
    stage_runs,
    scenes,
    machine_seconds / 3600 * CAST(price_usd_per_hour AS DOUBLE) AS cost_usd,
    machine_seconds / 3600 * CAST(price_usd_per_hour AS DOUBLE) / nullif(scenes, 0) AS cost_usd_per_scene,
    machine_seconds / 3600 * CAST(price_usd_per_hour AS DOUBLE) / nullif(wall_seconds / 3600, 0) AS cost_usd_per_hour
FROM run_overview
ORDER BY run_number
