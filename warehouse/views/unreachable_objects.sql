-- Which objects can no agent get to, and why?
SELECT
    unreachable_targets.scene_id,
    unreachable_targets.instance_id,
    instances.category,
    unreachable_targets.reason
FROM unreachable_targets
LEFT JOIN instances USING (scene_id, instance_id)
ORDER BY unreachable_targets.scene_id, unreachable_targets.instance_id
