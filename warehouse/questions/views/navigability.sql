-- How much of each scene's floor can an agent reach, and how many objects could no episode be made for (unreachable_targets)?
-- Version 1.
WITH trips AS (
    SELECT scene_id, agent, count(*) AS episodes, count(DISTINCT instance_id) AS targets
    FROM episodes
    GROUP BY scene_id, agent
),
unreachable AS (
    SELECT scene_id, count(*) AS unreachable_targets
    FROM unreachable_targets
    GROUP BY scene_id
)
SELECT
    navmeshes.scene_id,
    navmeshes.agent,
    shells.floor_area_m2,
    navmeshes.area_m2,
    navmeshes.area_m2 / nullif(shells.floor_area_m2, 0) AS navigable_share,
    navmeshes.largest_island_m2 / nullif(navmeshes.area_m2, 0) AS largest_island_share,
    navmeshes.island_count,
    coalesce(trips.episodes, 0) AS episodes,
    coalesce(trips.targets, 0) AS targets,
    coalesce(unreachable.unreachable_targets, 0) AS unreachable_targets
FROM navmeshes
LEFT JOIN shells USING (scene_id)
LEFT JOIN trips USING (scene_id, agent)
LEFT JOIN unreachable USING (scene_id)
ORDER BY navmeshes.scene_id, navmeshes.agent
