-- How large are the objects of each category: quartiles, whiskers at 1.5 times the interquartile range, outliers?
WITH quartiles AS (
    SELECT
        category,
        count(*) AS objects,
        quantile_cont(box_volume_m3, 0.25) AS q1_m3,
        quantile_cont(box_volume_m3, 0.5) AS median_m3,
        quantile_cont(box_volume_m3, 0.75) AS q3_m3
    FROM instances
    WHERE NOT is_structure
    GROUP BY category
)
SELECT
    row_number() OVER (ORDER BY any_value(quartiles.objects) DESC, category) AS frequency_rank,
    category,
    any_value(quartiles.objects) AS objects,
    min(box_volume_m3) AS smallest_m3,
    least(any_value(q1_m3), min(box_volume_m3) FILTER (box_volume_m3 >= q1_m3 - 1.5 * (q3_m3 - q1_m3))) AS whisker_low_m3,
    any_value(q1_m3) AS q1_m3,
    any_value(median_m3) AS median_m3,
    any_value(q3_m3) AS q3_m3,
    greatest(any_value(q3_m3), max(box_volume_m3) FILTER (box_volume_m3 <= q3_m3 + 1.5 * (q3_m3 - q1_m3))) AS whisker_high_m3,
    max(box_volume_m3) AS largest_m3,
    count(*) FILTER (
        box_volume_m3 < q1_m3 - 1.5 * (q3_m3 - q1_m3) OR box_volume_m3 > q3_m3 + 1.5 * (q3_m3 - q1_m3)
    ) AS outliers
FROM instances
JOIN quartiles USING (category)
WHERE NOT is_structure
GROUP BY category
ORDER BY frequency_rank
