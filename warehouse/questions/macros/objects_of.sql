-- Which objects does a scene hold, and what stands for each?
-- Version 2.
-- Rows of the view scene_objects.
-- Example: FROM objects_of('<dataset>/<scan>')
CREATE MACRO objects_of(scene) AS TABLE
SELECT *
FROM scene_objects
WHERE scene_id = scene
ORDER BY instance_id
