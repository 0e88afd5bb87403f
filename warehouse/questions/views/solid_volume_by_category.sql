-- How large are the solids placed for the objects of each category: quartiles, whiskers at 1.5 times the interquartile range, outliers?
-- Version 1.
-- Solids as in the view placed_solids. A whisker ends at the last volume within reach and never inside the box.
WITH listed AS (
    SELECT
        category,
        count(*) AS objects,
        min(solid_volume_m3) AS smallest_m3,
        max(solid_volume_m3) AS largest_m3,
        quantile_cont(solid_volume_m3, [0.25, 0.5, 0.75]) AS quartiles,
        list(solid_volume_m3) AS volumes
    FROM placed_solids
    GROUP BY category
),
-- Volumes are kept from the one reading of the table and put beside their fences: a join would look up millions of names.
fences AS (
    SELECT
        category,
        quartiles[1] - 1.5 * (quartiles[3] - quartiles[1]) AS low_m3,
        quartiles[3] + 1.5 * (quartiles[3] - quartiles[1]) AS high_m3,
        unnest(volumes) AS volume_m3
    FROM listed
),
inside AS (
    SELECT
        category,
        min(volume_m3) FILTER (volume_m3 >= low_m3) AS low_m3,
        max(volume_m3) FILTER (volume_m3 <= high_m3) AS high_m3,
        count(*) FILTER (volume_m3 < low_m3 OR volume_m3 > high_m3) AS outliers
    FROM fences
    GROUP BY category
)
SELECT
    row_number() OVER (ORDER BY listed.objects DESC, category) AS frequency_rank,
    category,
    listed.objects,
    listed.smallest_m3,
    least(listed.quartiles[1], inside.low_m3) AS whisker_low_m3,
    listed.quartiles[1] AS q1_m3,
    listed.quartiles[2] AS median_m3,
    listed.quartiles[3] AS q3_m3,
    greatest(listed.quartiles[3], inside.high_m3) AS whisker_high_m3,
    listed.largest_m3,
    inside.outliers
FROM listed
JOIN inside USING (category)
ORDER BY frequency_rank
