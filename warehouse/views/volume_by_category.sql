-- How large are the objects of each category: quartiles, whiskers at 1.5 times the interquartile range, outliers?
-- Version 1.
-- Oriented boxes of the scan. A whisker ends at the last volume within the fences and never inside the box.
WITH inside AS (
    SELECT
        category,
        min(box_volume_m3) FILTER (box_volume_m3 >= fence_low_m3) AS low_m3,
        max(box_volume_m3) FILTER (box_volume_m3 <= fence_high_m3) AS high_m3,
        count(*) FILTER (box_volume_m3 < fence_low_m3 OR box_volume_m3 > fence_high_m3) AS outliers
    FROM instances
    JOIN volume_quartiles USING (category)
    WHERE NOT is_structure
    GROUP BY category
)
SELECT
    row_number() OVER (ORDER BY volume_quartiles.objects DESC, category) AS frequency_rank,
    category,
    volume_quartiles.objects,
    volume_quartiles.smallest_m3,
    least(volume_quartiles.q1_m3, inside.low_m3) AS whisker_low_m3,
    volume_quartiles.q1_m3,
    volume_quartiles.median_m3,
    volume_quartiles.q3_m3,
    greatest(volume_quartiles.q3_m3, inside.high_m3) AS whisker_high_m3,
    volume_quartiles.largest_m3,
    inside.outliers
FROM volume_quartiles
JOIN inside USING (category)
ORDER BY frequency_rank
