-- Which scenes were made of the same scan, under several names?
-- Version 1.
-- Scenes whose captures that count (view current_runs) read the same files, or the same but for the scan's own name in their paths; each
-- with the first of them by name and how many they are. rooms: names of rooms that these have, without the dataset, as splits go by them:
-- with more than one, train and test may share a scan. Runs take a copy for the scene that is there, but when it had another content
-- before.
WITH RECURSIVE captured AS (
    SELECT
        scene_id,
        list_filter(reasons, lambda part: starts_with(part, 'scan='))[1] AS scan,
        list_filter(reasons, lambda part: starts_with(part, 'content='))[1] AS content
    FROM current_runs
    WHERE stage = 'capture'
),
linked AS (
    SELECT one.scene_id, other.scene_id AS same_as
    FROM captured AS one
    JOIN captured AS other ON one.scan = other.scan AND one.scene_id <> other.scene_id
    UNION
    SELECT one.scene_id, other.scene_id AS same_as
    FROM captured AS one
    JOIN captured AS other ON one.content = other.content AND one.scene_id <> other.scene_id
),
reached AS (
    SELECT scene_id, same_as
    FROM linked
    UNION
    SELECT reached.scene_id, linked.same_as
    FROM reached
    JOIN linked ON linked.scene_id = reached.same_as
),
grouped AS (
    SELECT scene_id, min(same_as) AS first_scene_id, count(*) AS scenes
    FROM reached
    GROUP BY scene_id
)
SELECT
    grouped.scene_id,
    grouped.first_scene_id,
    grouped.scenes,
    scenes.room_id,
    count(DISTINCT regexp_replace(scenes.room_id, '^[^/]*/', '')) OVER (PARTITION BY grouped.first_scene_id) AS rooms,
    scenes.scan_path
FROM grouped
LEFT JOIN scenes USING (scene_id)
ORDER BY grouped.first_scene_id, grouped.scene_id
