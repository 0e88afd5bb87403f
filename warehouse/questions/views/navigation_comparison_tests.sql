-- Is one training dataset better than another for navigation, or is the difference chance?
-- Version 1.
-- One row per comparison, test dataset, two choices of training datasets and measure (success, spl). A pair is two policies of one seed in
-- one episode; difference is the mean of the first minus that of the second, only_first and only_second count pairs in which one of them
-- was better. p_value is that of McNemar's exact test for success and of flips of signs for spl, pairs taken as independent.
-- p_value_by_scene flips the signs of whole scenes: it holds also where episodes of a scene are alike, and cannot be below
-- 2 / 2^scenes. No p value is corrected for the number of pairs of datasets. Comparisons with a model that was withdrawn are left out.
SELECT
    tests.comparison_id,
    tests.tested_on,
    tests.first,
    tests.second,
    tests.measure,
    tests.pairs,
    tests.scenes,
    tests.first_mean,
    tests.second_mean,
    tests.first_mean - tests.second_mean AS difference,
    tests.only_first,
    tests.only_second,
    tests.p_value,
    tests.p_value_by_scene
FROM paired_tests AS tests
WHERE tests.comparison_id NOT IN (
    SELECT compared_runs.comparison_id FROM compared_runs JOIN models USING (model_id) WHERE models.is_withdrawn
)
ORDER BY tests.comparison_id, tests.tested_on, tests.first, tests.second, tests.measure
