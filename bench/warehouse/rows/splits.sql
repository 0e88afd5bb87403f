SELECT room_id, split
FROM scenes_now
WHERE NOT is_rescan
