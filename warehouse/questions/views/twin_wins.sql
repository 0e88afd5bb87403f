-- How often does the textured twin of a candidate win against its plain sibling?
-- Version 1.
-- By who painted and whose asset was painted. twins: slots that were to be twins of a sibling that is there; painted: those that are. Of
-- slots that a fallback filled nobody says who was to paint them (painter is missing).
-- above: painted twins that selection ranks before their sibling; chosen, plain_chosen: that it ranks first of all, and siblings that it
-- does. people_chose, people_chose_plain: answers that count (view current_answers) and choose the twin, or its sibling; an asset that two
-- slots share counts for both.
WITH pairs AS (
    SELECT
        twins.scene_id,
        twins.instance_id,
        CASE WHEN twins.is_fallback THEN NULL ELSE twins.provider END AS painter,
        plain.provider AS plain_provider,
        twins.seen_share,
        CASE WHEN twins.outcome = 'filled' AND NOT twins.is_fallback THEN twins.asset_id END AS twin,
        plain.asset_id AS plain,
        twin_ranked.rank AS twin_rank,
        plain_ranked.rank AS plain_rank
    FROM candidates AS twins
    JOIN candidates AS plain
        ON plain.scene_id = twins.scene_id
        AND plain.instance_id = twins.instance_id
        AND plain.slot = twins.twin_of
        AND plain.outcome = 'filled'
    LEFT JOIN selections AS twin_ranked
        ON twin_ranked.scene_id = twins.scene_id
        AND twin_ranked.instance_id = twins.instance_id
        AND twin_ranked.slot = twins.slot
    LEFT JOIN selections AS plain_ranked
        ON plain_ranked.scene_id = twins.scene_id
        AND plain_ranked.instance_id = twins.instance_id
        AND plain_ranked.slot = twins.twin_of
    WHERE twins.twin_of IS NOT NULL
),
answered AS (
    SELECT pairs.painter, pairs.plain_provider, count(*) FILTER (answers.choice = pairs.twin) AS twin,
        count(*) FILTER (answers.choice = pairs.plain) AS plain
    FROM pairs
    JOIN current_answers AS answers USING (scene_id, instance_id)
    WHERE pairs.twin IS NOT NULL
    GROUP BY pairs.painter, pairs.plain_provider
),
counted AS (
    SELECT
        painter,
        plain_provider,
        count(*) AS twins,
        count(twin) AS painted,
        avg(seen_share) AS mean_seen_share,
        count(*) FILTER (twin IS NOT NULL AND twin_rank IS NOT NULL AND plain_rank IS NOT NULL) AS compared,
        count(*) FILTER (twin IS NOT NULL AND twin_rank < plain_rank) AS above,
        count(*) FILTER (twin IS NOT NULL AND twin_rank = 1) AS chosen,
        count(*) FILTER (twin IS NOT NULL AND plain_rank = 1) AS plain_chosen
    FROM pairs
    GROUP BY painter, plain_provider
)
SELECT
    counted.*,
    counted.above / nullif(counted.compared, 0) AS above_share,
    coalesce(answered.twin, 0) AS people_chose,
    coalesce(answered.plain, 0) AS people_chose_plain
FROM counted
LEFT JOIN answered ON answered.painter = counted.painter AND answered.plain_provider = counted.plain_provider
ORDER BY painter, plain_provider
