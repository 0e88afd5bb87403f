-- Which placed solids are unusually small or large for their category?
-- Version 1.
-- Solids as in the view placed_solids, farther from the quartiles than 1.5 times the interquartile range. In no order: there may be
-- hundreds of thousands.
WITH solids AS MATERIALIZED (
    SELECT scene_id, instance_id, category, solid_volume_m3
    FROM placed_solids
),
boxes AS (
    SELECT category, quantile_cont(solid_volume_m3, [0.25, 0.5, 0.75]) AS quartiles
    FROM solids
    GROUP BY category
)
SELECT
    category,
    solids.scene_id,
    solids.instance_id,
    solids.solid_volume_m3,
    boxes.quartiles[2] AS median_m3,
    solids.solid_volume_m3 / nullif(boxes.quartiles[2], 0) AS times_median
FROM solids
JOIN boxes USING (category)
WHERE solids.solid_volume_m3 < boxes.quartiles[1] - 1.5 * (boxes.quartiles[3] - boxes.quartiles[1])
    OR solids.solid_volume_m3 > boxes.quartiles[3] + 1.5 * (boxes.quartiles[3] - boxes.quartiles[1])
