-- How often does a library have an asset for objects of each category, and how often does that win over what was made instead?
-- Version 1.
-- By slot, of those in which any candidate of the lake is a library's. retrieved: objects for which it is one; fallbacks: for which
-- something was made instead, since the library had none. wins, fallback_wins: of either, those that selection ranks first of all that the
-- object has. above: retrieved ones that it ranks before every fallback of their object, in any of these slots, out of those that have one
-- (compared). placed: retrieved ones that stand for the object in the end. The view library_usage has libraries, candidate_wins all
-- providers.
WITH library_slots AS (
    SELECT DISTINCT slot
    FROM candidates
    WHERE provider = 'library'
),
offered AS (
    SELECT
        candidates.scene_id,
        candidates.instance_id,
        candidates.slot,
        candidates.asset_id,
        candidates.library_score,
        selections.rank,
        candidates.outcome = 'filled' AND candidates.provider = 'library' AS is_retrieved,
        candidates.outcome = 'filled' AND candidates.is_fallback AS is_made
    FROM candidates
    JOIN library_slots USING (slot)
    LEFT JOIN selections
        ON selections.scene_id = candidates.scene_id
        AND selections.instance_id = candidates.instance_id
        AND selections.slot = candidates.slot
),
held AS (
    SELECT *, min(rank) FILTER (is_made) OVER (PARTITION BY scene_id, instance_id) AS best_made_rank
    FROM offered
),
counted AS (
    SELECT
        instances.category,
        held.slot,
        count(*) AS objects,
        count(*) FILTER (held.is_retrieved) AS retrieved,
        count(*) FILTER (held.is_made) AS fallbacks,
        avg(held.library_score) FILTER (held.is_retrieved) AS mean_library_score,
        count(*) FILTER (held.is_retrieved AND held.rank = 1) AS wins,
        count(*) FILTER (held.is_made AND held.rank = 1) AS fallback_wins,
        count(held.best_made_rank) FILTER (held.is_retrieved AND held.rank IS NOT NULL) AS compared,
        count(*) FILTER (held.is_retrieved AND held.rank < held.best_made_rank) AS above,
        count(*) FILTER (held.is_retrieved AND placements.instance_id IS NOT NULL) AS placed
    FROM held
    LEFT JOIN instances USING (scene_id, instance_id)
    LEFT JOIN placements
        ON placements.scene_id = held.scene_id
        AND placements.instance_id = held.instance_id
        AND placements.asset_id = held.asset_id
    GROUP BY instances.category, held.slot
)
SELECT
    category,
    slot,
    objects,
    retrieved,
    fallbacks,
    retrieved / objects AS retrieved_share,
    mean_library_score,
    wins,
    wins / nullif(retrieved, 0) AS win_share,
    fallback_wins,
    fallback_wins / nullif(fallbacks, 0) AS fallback_win_share,
    compared,
    above,
    above / nullif(compared, 0) AS above_share,
    placed
FROM counted
ORDER BY category, slot
