-- Between which volumes does the middle half of each category's objects lie, and from where on is a volume unusual?
-- Version 1.
-- Oriented boxes of the scan. Beyond the fences, 1.5 times the interquartile range from the quartiles, a volume is an outlier.
SELECT
    category,
    objects,
    smallest_m3,
    quartiles[1] - 1.5 * (quartiles[3] - quartiles[1]) AS fence_low_m3,
    quartiles[1] AS q1_m3,
    quartiles[2] AS median_m3,
    quartiles[3] AS q3_m3,
    quartiles[3] + 1.5 * (quartiles[3] - quartiles[1]) AS fence_high_m3,
    largest_m3
FROM (
    SELECT
        category,
        count(*) AS objects,
        min(box_volume_m3) AS smallest_m3,
        max(box_volume_m3) AS largest_m3,
        quantile_cont(box_volume_m3, [0.25, 0.5, 0.75]) AS quartiles
    FROM instances
    WHERE NOT is_structure
    GROUP BY category
)
ORDER BY category
