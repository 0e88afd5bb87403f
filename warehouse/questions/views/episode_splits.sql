-- How many episodes does each split hold, and how long are they?
-- Version 1.
SELECT
    episodes.split,
    count(DISTINCT scenes.room_id) AS rooms,
    count(DISTINCT episodes.scene_id) AS scenes,
    count(*) AS episodes,
    count(DISTINCT episodes.category) AS categories,
    quantile_cont(episodes.geodesic_m, 0.5) AS median_geodesic_m,
    max(episodes.geodesic_m) AS longest_geodesic_m,
    avg(len(episodes.actions)) AS mean_actions
FROM episodes
LEFT JOIN scenes USING (scene_id)
GROUP BY episodes.split
ORDER BY episodes.split
