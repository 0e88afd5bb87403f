-- Which assets stand for more than one object?
-- Version 1.
-- The most used first. most_in_scene: objects of one scene that it stands for at most; categories: of these objects, the most frequent
-- first. Instances that are gone have none. The view attributions has all placed assets by author and license.
WITH used AS (
    SELECT placements.asset_id, placements.scene_id, instances.category, scenes.room_id, count(*) AS objects
    FROM placements
    LEFT JOIN instances USING (scene_id, instance_id)
    LEFT JOIN scenes ON scenes.scene_id = placements.scene_id
    GROUP BY ALL
),
per_scene AS (
    SELECT asset_id, scene_id, sum(objects) AS objects
    FROM used
    GROUP BY asset_id, scene_id
),
spread AS (
    SELECT asset_id, CAST(sum(objects) AS BIGINT) AS objects, count(*) AS scenes, CAST(max(objects) AS BIGINT) AS most_in_scene
    FROM per_scene
    GROUP BY asset_id
    HAVING sum(objects) > 1
),
named AS (
    SELECT asset_id, list(category ORDER BY objects DESC, category) AS categories
    FROM (
        SELECT asset_id, category, sum(objects) AS objects
        FROM used
        WHERE category IS NOT NULL
        GROUP BY asset_id, category
    )
    GROUP BY asset_id
),
housed AS (
    SELECT asset_id, count(DISTINCT room_id) AS rooms
    FROM used
    GROUP BY asset_id
)
SELECT
    asset_id,
    assets.name,
    assets.provider,
    assets.category,
    spread.objects,
    spread.scenes,
    housed.rooms,
    spread.most_in_scene,
    coalesce(named.categories, []) AS categories
FROM spread
JOIN housed USING (asset_id)
LEFT JOIN named USING (asset_id)
LEFT JOIN assets USING (asset_id)
ORDER BY spread.objects DESC, asset_id
