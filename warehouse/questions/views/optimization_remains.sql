-- What could the optimization not put right?
-- Version 1.
-- A line that begins with an instance's id is about that instance; the others are about the scene.
-- What moves in an engine is among them, the engine in brackets: mujoco, mujoco_defaults or newton.
WITH lines AS (
    SELECT scene_id, unnest(remains) AS line
    FROM optimizations
),
said AS (
    SELECT
        scene_id,
        nullif(regexp_extract(line, '^([0-9]{4,}): ', 1), '') AS instance_id,
        regexp_replace(line, '^[0-9]{4,}: ', '') AS remains
    FROM lines
    UNION
    SELECT scene_id, instance_id, remains
    FROM placements
    WHERE remains IS NOT NULL
)
SELECT said.scene_id, said.instance_id, instances.category, said.remains
FROM said
LEFT JOIN instances USING (scene_id, instance_id)
ORDER BY said.scene_id, said.instance_id NULLS FIRST, said.remains
