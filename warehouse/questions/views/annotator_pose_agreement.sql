-- How far apart do two annotators put the same asset for the same instance?
-- Version 2.
-- Of each annotator the answer that counts (view current_answers), where both chose one asset; who gave no transform left it as selection
-- aligned it. Distances are between the assets' origins, turns the least angle that takes one pose to the other, size ratios the larger
-- volume over the smaller. Instances that were numbered anew since are not told apart.
WITH placed AS (
    SELECT
        answers.scene_id,
        answers.instance_id,
        answers.annotator,
        answers.choice,
        coalesce(answers.pose, any_value(selections.pose)) AS pose,
        coalesce(answers.scale, any_value(selections.scale)) AS scale
    FROM current_answers AS answers
    LEFT JOIN selections
        ON selections.scene_id = answers.scene_id
        AND selections.instance_id = answers.instance_id
        AND selections.asset_id = answers.choice
    WHERE answers.choice IS NOT NULL
    GROUP BY answers.scene_id, answers.instance_id, answers.annotator, answers.choice, answers.pose, answers.scale
),
pairs AS (
    SELECT
        a.annotator AS annotator_a,
        b.annotator AS annotator_b,
        sqrt((a.pose[4] - b.pose[4]) ** 2 + (a.pose[8] - b.pose[8]) ** 2 + (a.pose[12] - b.pose[12]) ** 2) AS distance_m,
        acos(
            greatest(
                -1.0,
                least(
                    1.0,
                    (
                        list_dot_product(a.pose[1:3], b.pose[1:3])
                        + list_dot_product(a.pose[5:7], b.pose[5:7])
                        + list_dot_product(a.pose[9:11], b.pose[9:11])
                        - 1.0
                    ) / 2
                )
            )
        ) AS turn_radians,
        exp(abs(ln((a.scale[1] * a.scale[2] * a.scale[3]) / (b.scale[1] * b.scale[2] * b.scale[3])))) AS size_ratio
    FROM placed AS a
    JOIN placed AS b USING (scene_id, instance_id, choice)
    WHERE a.annotator < b.annotator AND a.pose IS NOT NULL AND b.pose IS NOT NULL AND a.scale IS NOT NULL AND b.scale IS NOT NULL
)
SELECT
    annotator_a,
    annotator_b,
    count(*) AS instances,
    quantile_cont(distance_m, 0.5) AS median_distance_m,
    quantile_cont(distance_m, 0.9) AS p90_distance_m,
    degrees(quantile_cont(turn_radians, 0.5)) AS median_turn_degrees,
    degrees(quantile_cont(turn_radians, 0.9)) AS p90_turn_degrees,
    quantile_cont(size_ratio, 0.5) AS median_size_ratio
FROM pairs
GROUP BY annotator_a, annotator_b
ORDER BY annotator_a, annotator_b
