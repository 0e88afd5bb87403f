-- Which objects could no episode be made for, and why?
-- Version 1.
-- Most of them no agent gets near; the reason says where it is something else.
SELECT
    unreachable_targets.scene_id,
    unreachable_targets.instance_id,
    instances.category,
    unreachable_targets.reason
FROM unreachable_targets
LEFT JOIN instances USING (scene_id, instance_id)
ORDER BY unreachable_targets.scene_id, unreachable_targets.instance_id
