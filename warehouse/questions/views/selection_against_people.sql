-- Where does selection propose something else than people choose: of which categories, providers and sizes?
-- Version 1.
-- dimension is what the rows are told apart by: the instance's category, the provider of the candidate that selection ranks first, or the size of
-- the instance's box (small below 10 l, medium below 200 l, large). Of each annotator the answer that counts (view current_answers), where
-- selection ranked anything. same: they chose what it ranks first; in_next_four: what it ranks 2nd to 5th; elsewhere: what it ranks later
-- or not at all. chosen_of_provider counts, for a provider, the answers that chose one of its candidates, whatever was proposed.
WITH best AS (
    SELECT scene_id, instance_id, asset_id, slot
    FROM selections
    WHERE rank = 1
),
ranks AS (
    SELECT scene_id, instance_id, asset_id, min(rank) AS rank
    FROM selections
    GROUP BY scene_id, instance_id, asset_id
),
providers AS (
    SELECT scene_id, instance_id, asset_id, min(provider) AS provider
    FROM candidates
    WHERE asset_id IS NOT NULL
    GROUP BY scene_id, instance_id, asset_id
),
compared AS (
    SELECT
        instances.category,
        proposed.provider,
        CASE WHEN instances.box_volume_m3 < 0.01 THEN 'small' WHEN instances.box_volume_m3 < 0.2 THEN 'medium' ELSE 'large' END AS size,
        chosen.provider AS chosen_provider,
        answers.choice,
        ranks.rank
    FROM current_answers AS answers
    JOIN instances USING (scene_id, instance_id)
    JOIN best ON best.scene_id = answers.scene_id AND best.instance_id = answers.instance_id
    LEFT JOIN providers AS proposed
        ON proposed.scene_id = best.scene_id AND proposed.instance_id = best.instance_id AND proposed.asset_id = best.asset_id
    LEFT JOIN ranks
        ON ranks.scene_id = answers.scene_id AND ranks.instance_id = answers.instance_id AND ranks.asset_id = answers.choice
    LEFT JOIN providers AS chosen
        ON chosen.scene_id = answers.scene_id AND chosen.instance_id = answers.instance_id AND chosen.asset_id = answers.choice
),
parted AS (
    SELECT 'category' AS dimension, category AS value, choice, rank FROM compared
    UNION ALL
    SELECT 'provider', coalesce(provider, 'unknown'), choice, rank FROM compared
    UNION ALL
    SELECT 'size', size, choice, rank FROM compared
),
chosen_of AS (
    SELECT 'provider' AS dimension, chosen_provider AS value, count(*) AS answers
    FROM compared
    WHERE chosen_provider IS NOT NULL
    GROUP BY chosen_provider
),
counted AS (
    SELECT
        dimension,
        value,
        count(*) AS answers,
        count(*) FILTER (choice IS NULL) AS none_fits,
        count(*) FILTER (rank = 1) AS same,
        count(*) FILTER (rank BETWEEN 2 AND 5) AS in_next_four,
        count(*) FILTER (choice IS NOT NULL AND (rank IS NULL OR rank > 5)) AS elsewhere,
        avg(rank) AS mean_rank
    FROM parted
    GROUP BY dimension, value
)
SELECT
    coalesce(counted.dimension, chosen_of.dimension) AS dimension,
    coalesce(counted.value, chosen_of.value) AS value,
    coalesce(counted.answers, 0) AS answers,
    coalesce(counted.none_fits, 0) AS none_fits,
    coalesce(counted.same, 0) AS same,
    coalesce(counted.in_next_four, 0) AS in_next_four,
    coalesce(counted.elsewhere, 0) AS elsewhere,
    counted.mean_rank,
    counted.same / counted.answers AS same_share,
    counted.none_fits / counted.answers AS none_fits_share,
    CASE WHEN coalesce(counted.dimension, chosen_of.dimension) = 'provider' THEN coalesce(chosen_of.answers, 0) END AS chosen_of_provider
FROM counted
FULL JOIN chosen_of ON chosen_of.dimension = counted.dimension AND chosen_of.value = counted.value
ORDER BY 1, 3 DESC, 2
