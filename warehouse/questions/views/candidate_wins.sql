-- Which provider's candidates, in which slot, are selected, and which are placed in the end?
-- Version 2.
-- placed: wins that stand in the scene in the end. The others gave way to a candidate that leaves its neighbors their place, or to
-- what people chose (the view annotation_wins).
WITH counted AS (
    SELECT
        provider,
        slot,
        count(*) AS candidates,
        count(*) FILTER (outcome = 'filled') AS filled,
        count(*) FILTER (is_fallback) AS fallbacks
    FROM candidates
    GROUP BY provider, slot
),
-- Candidates outnumber objects by ten. Nearly all of a slot are its usual provider's, and so are all wins of the slot but those of
-- the few others: only these are looked up one by one.
usual AS (
    SELECT slot, arg_max(provider, candidates) AS provider
    FROM counted
    GROUP BY slot
),
won AS (
    SELECT selections.scene_id, selections.instance_id, selections.slot, selections.score, placements.scene_id IS NOT NULL AS is_placed
    FROM selections
    LEFT JOIN placements
        ON placements.scene_id = selections.scene_id
        AND placements.instance_id = selections.instance_id
        AND placements.origin = 'selection'
        AND placements.asset_id = selections.asset_id
    WHERE selections.rank = 1
),
of_slot AS (
    SELECT slot, count(*) AS wins, sum(score) AS score, count(*) FILTER (is_placed) AS placed
    FROM won
    GROUP BY slot
),
others AS MATERIALIZED (
    SELECT candidates.scene_id, candidates.instance_id, slot, candidates.provider
    FROM candidates
    JOIN usual USING (slot)
    WHERE candidates.provider <> usual.provider
),
of_others AS (
    SELECT others.provider, slot, count(*) AS wins, sum(won.score) AS score, count(*) FILTER (won.is_placed) AS placed
    FROM others
    JOIN won USING (scene_id, instance_id, slot)
    GROUP BY others.provider, slot
),
of_usual AS (
    SELECT
        usual.provider,
        slot,
        of_slot.wins - coalesce(rest.wins, 0) AS wins,
        of_slot.score - coalesce(rest.score, 0) AS score,
        of_slot.placed - coalesce(rest.placed, 0) AS placed
    FROM usual
    JOIN of_slot USING (slot)
    LEFT JOIN (
        SELECT slot, sum(wins) AS wins, sum(score) AS score, sum(placed) AS placed
        FROM of_others
        GROUP BY slot
    ) AS rest USING (slot)
),
wins AS (
    FROM of_others
    UNION ALL
    FROM of_usual
)
SELECT
    provider,
    slot,
    counted.candidates,
    counted.filled,
    counted.fallbacks,
    CAST(coalesce(wins.wins, 0) AS BIGINT) AS wins,
    coalesce(wins.wins, 0) / nullif(counted.filled, 0) AS win_share,
    wins.score / nullif(wins.wins, 0) AS mean_winning_score,
    CAST(coalesce(wins.placed, 0) AS BIGINT) AS placed
FROM counted
LEFT JOIN wins USING (provider, slot)
ORDER BY slot, provider
