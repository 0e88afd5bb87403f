-- What was added, moved and removed between two scans of a room?
-- Version 1.
-- One row per object that is not as it was; from_scene is the earlier scan. Lengths are in metres, turn_degrees about the vertical, the
-- smallest turn that the object's shape allows. What only one scan shows counts as added or removed where the other saw its place. What the
-- other never saw, and what it shows without naming it, is no change: rescan_objects has these as not_seen and unnamed. Scans that do not
-- fit onto each other have no rows here; rescans says why. found_by is who found the object, in the later scan where both have it: what
-- was guessed from geometry or frames in one scan may have been missed in the other.
SELECT
    rescans.room_id,
    rescans.reference_scene_id AS from_scene,
    rescans.scene_id AS to_scene,
    objects.change,
    objects.category,
    objects.reference_instance_id AS from_instance,
    objects.instance_id AS to_instance,
    CASE WHEN objects.change = 'moved' THEN objects.distance_m END AS distance_m,
    CASE WHEN objects.change = 'moved' THEN degrees(objects.turn_radians) END AS turn_degrees,
    objects.seen_share,
    coalesce(later.found_by, earlier.found_by) AS found_by
FROM rescans
JOIN rescan_objects AS objects USING (scene_id, reference_scene_id)
LEFT JOIN instances AS later ON later.scene_id = objects.scene_id AND later.instance_id = objects.instance_id
LEFT JOIN instances AS earlier
    ON earlier.scene_id = objects.reference_scene_id AND earlier.instance_id = objects.reference_instance_id
WHERE objects.change IN ('added', 'moved', 'removed')
ORDER BY rescans.room_id, to_scene, from_scene, objects.number
