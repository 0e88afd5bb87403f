-- Which provider's candidates, in which slot, are selected, and which are placed in the end?
-- An asset that two slots of an instance share counts as placed in both.
SELECT
    candidates.provider,
    candidates.slot,
    count(*) AS candidates,
    count(*) FILTER (candidates.outcome = 'filled') AS filled,
    count(*) FILTER (candidates.is_fallback) AS fallbacks,
    count(selections.asset_id) AS wins,
    count(selections.asset_id) / nullif(count(*) FILTER (candidates.outcome = 'filled'), 0) AS win_share,
    avg(selections.score) AS mean_winning_score,
    count(placements.asset_id) AS placed
FROM candidates
LEFT JOIN selections
    ON selections.scene_id = candidates.scene_id
    AND selections.instance_id = candidates.instance_id
    AND selections.slot = candidates.slot
    AND selections.rank = 1
LEFT JOIN placements
    ON placements.scene_id = candidates.scene_id
    AND placements.instance_id = candidates.instance_id
    AND placements.asset_id = candidates.asset_id
GROUP BY candidates.provider, candidates.slot
ORDER BY candidates.slot, candidates.provider
