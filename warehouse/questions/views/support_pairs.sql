-- What stands on what: which categories carry which, and how often?
-- Version 1.
-- carrier_category: of what carries them on itself or inside; missing where the room does, of which relation says floor, wall or ceiling,
-- and where nothing does. category_share is of all objects of the category, carrier_share of all that this category (or this part of the
-- room) carries in any way. kept: it carries them still after the optimization. The view support_counts has this by scene, the view
-- micro_scene_pairs what belongs to large objects through others, too.
WITH carried AS (
    SELECT
        objects.category,
        supports.relation,
        carriers.category AS carrier_category,
        coalesce(carriers.category, supports.relation) AS carrier,
        carriers.category IS NULL AS is_room,
        count(*) AS objects,
        count(DISTINCT supports.scene_id) AS scenes,
        count(*) FILTER (supports.is_kept) AS kept
    FROM supports
    LEFT JOIN instances AS objects USING (scene_id, instance_id)
    LEFT JOIN instances AS carriers ON carriers.scene_id = supports.scene_id AND carriers.instance_id = supports.parent_id
    GROUP BY ALL
)
SELECT
    carrier_category,
    relation,
    category,
    objects,
    scenes,
    objects / sum(objects) OVER (PARTITION BY category) AS category_share,
    objects / sum(objects) OVER (PARTITION BY carrier, is_room) AS carrier_share,
    kept,
    kept / objects AS kept_share
FROM carried
ORDER BY objects DESC, carrier_category, relation, category
