-- Is one training dataset better than another for navigation, or is the difference chance?
-- Version 2.
-- One row per comparison, test dataset, two choices of training datasets and measure (success, spl). A pair is two policies of one seed in
-- one episode; difference is the mean of the first minus that of the second, only_first and only_second count pairs in which one of them
-- was better. Each p value is about something else. p_value is about these very models in episodes like these: McNemar's exact test for
-- success, flips of signs for spl, pairs taken as independent. p_value_by_scene is about these very models in other scenes: it flips the
-- signs of whole scenes, and cannot be below 2 / 2^scenes. Neither is about the datasets: a training with a lucky seed is better in all
-- scenes alike. p_value_by_seed is, about other trainings on the same datasets in these scenes: it flips the signs of whole seeds, and
-- cannot be below 2 / 2^seeds, so that three seeds never give less than 0.25. By one scene, or by one seed, there is no p value. None is
-- corrected for the number of pairs of datasets. Comparisons with a model that was withdrawn are left out, and so are tests that counted a
-- scene which was erased since.
WITH compared AS (
    SELECT comparison_id, trained_on, split_part(scene_id, '/', 1) AS tested_on, count(DISTINCT scene_id) AS scenes, sum(episodes) AS pairs
    FROM compared_runs
    GROUP BY ALL
)
SELECT
    tests.comparison_id,
    tests.tested_on,
    tests.first,
    tests.second,
    tests.measure,
    tests.pairs,
    tests.scenes,
    tests.seeds,
    tests.first_mean,
    tests.second_mean,
    tests.first_mean - tests.second_mean AS difference,
    tests.only_first,
    tests.only_second,
    tests.p_value,
    tests.p_value_by_scene,
    tests.p_value_by_seed
FROM paired_tests AS tests
JOIN compared AS of_first
    ON (of_first.comparison_id, of_first.trained_on, of_first.tested_on, of_first.scenes, of_first.pairs)
    = (tests.comparison_id, tests.first, tests.tested_on, tests.scenes, tests.pairs)
JOIN compared AS of_second
    ON (of_second.comparison_id, of_second.trained_on, of_second.tested_on, of_second.scenes, of_second.pairs)
    = (tests.comparison_id, tests.second, tests.tested_on, tests.scenes, tests.pairs)
WHERE tests.comparison_id NOT IN (
    SELECT compared_runs.comparison_id FROM compared_runs JOIN models USING (model_id) WHERE models.is_withdrawn
)
ORDER BY tests.comparison_id, tests.tested_on, tests.first, tests.second, tests.measure
