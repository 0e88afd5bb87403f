-- How large are the solids placed for the objects of each category: quartiles, whiskers at 1.5 times the interquartile range, outliers?
-- Version 1.
-- Solids as in the view placed_solids. A whisker ends at the last volume within reach and never inside the box.
WITH solids AS MATERIALIZED (
    SELECT category, solid_volume_m3
    FROM placed_solids
),
boxes AS (
    SELECT
        category,
        count(*) AS objects,
        min(solid_volume_m3) AS smallest_m3,
        max(solid_volume_m3) AS largest_m3,
        quantile_cont(solid_volume_m3, [0.25, 0.5, 0.75]) AS quartiles
    FROM solids
    GROUP BY category
),
fences AS (
    SELECT
        *,
        quartiles[1] - 1.5 * (quartiles[3] - quartiles[1]) AS fence_low_m3,
        quartiles[3] + 1.5 * (quartiles[3] - quartiles[1]) AS fence_high_m3
    FROM boxes
),
inside AS (
    SELECT
        category,
        min(solid_volume_m3) FILTER (solid_volume_m3 >= fence_low_m3) AS low_m3,
        max(solid_volume_m3) FILTER (solid_volume_m3 <= fence_high_m3) AS high_m3,
        count(*) FILTER (solid_volume_m3 < fence_low_m3 OR solid_volume_m3 > fence_high_m3) AS outliers
    FROM solids
    JOIN fences USING (category)
    GROUP BY category
)
SELECT
    row_number() OVER (ORDER BY boxes.objects DESC, category) AS frequency_rank,
    category,
    boxes.objects,
    boxes.smallest_m3,
    least(boxes.quartiles[1], inside.low_m3) AS whisker_low_m3,
    boxes.quartiles[1] AS q1_m3,
    boxes.quartiles[2] AS median_m3,
    boxes.quartiles[3] AS q3_m3,
    greatest(boxes.quartiles[3], inside.high_m3) AS whisker_high_m3,
    boxes.largest_m3,
    inside.outliers
FROM boxes
JOIN inside USING (category)
ORDER BY frequency_rank
