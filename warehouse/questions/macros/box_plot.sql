-- How are these numbers spread: quartiles, whiskers at 1.5 times the interquartile range, outliers?
-- Version 1.
-- A struct per list: numbers (how many), smallest, whisker_low, q1, median, q3, whisker_high, largest, outliers (sorted list).
-- Quartiles are interpolated; a whisker ends at the last number within reach and never inside the box. NULLs are left out.
-- Example: SELECT category, unnest(box_plot(list(mass_kg))) FROM captions JOIN instances USING (scene_id, instance_id) GROUP BY category
CREATE MACRO box_plot(numbers) AS list_transform(
    list_transform(
        [list_filter(CAST(numbers AS DOUBLE[]), lambda number: number IS NOT NULL)],
        lambda known: {'known': known, 'quartiles': list_aggregate(known, 'quantile_cont', [0.25, 0.5, 0.75])}
    ),
    lambda box: {
        'numbers': len(box.known),
        'smallest': list_min(box.known),
        'whisker_low': least(box.quartiles[1], list_min(list_filter(
            box.known, lambda number: number >= box.quartiles[1] - 1.5 * (box.quartiles[3] - box.quartiles[1])
        ))),
        'q1': box.quartiles[1],
        'median': box.quartiles[2],
        'q3': box.quartiles[3],
        'whisker_high': greatest(box.quartiles[3], list_max(list_filter(
            box.known, lambda number: number <= box.quartiles[3] + 1.5 * (box.quartiles[3] - box.quartiles[1])
        ))),
        'largest': list_max(box.known),
        'outliers': list_sort(list_filter(
            box.known,
            lambda number: number < box.quartiles[1] - 1.5 * (box.quartiles[3] - box.quartiles[1])
                OR number > box.quartiles[3] + 1.5 * (box.quartiles[3] - box.quartiles[1])
        ))
    }
)[1]
