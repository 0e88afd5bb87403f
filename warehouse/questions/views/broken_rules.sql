-- Which rules do exports break, and where?
-- Version 1.
SELECT format, rule, scene_id, message
FROM export_checks
WHERE NOT passed
ORDER BY format, rule, scene_id
