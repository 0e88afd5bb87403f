-- Which provider's candidates, in which slot, stand in the scenes because a person chose them?
-- Version 1.
-- An asset that two slots of an instance share counts in both.
SELECT candidates.provider, candidates.slot, count(*) AS placed
FROM candidates
JOIN placements USING (scene_id, instance_id, asset_id)
WHERE placements.origin = 'annotation'
GROUP BY candidates.provider, candidates.slot
ORDER BY candidates.slot, candidates.provider
