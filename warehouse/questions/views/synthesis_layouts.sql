-- What did synthesis models draw on one and the same large object?
-- Version 2.
-- Supplementary, figure A8. One row per drawn object as drawn, in the frame of the large one: +Z up, origin at the middle of the bottom of
-- its box, +X its front; one row without an object for scenes in which none was drawn. The large object is the same where model, category,
-- size and kind of room are; alike_scenes counts the scenes on it. yaw is the turn of the front about +Z.
SELECT
    drawn.model_kind,
    drawn.model_id,
    drawn.category AS large_category,
    drawn.room_type,
    drawn.box_size AS large_box_size,
    drawn.alike_scenes,
    drawn.scene_id,
    small.instance_id,
    small.category,
    small.box_center,
    small.box_size,
    degrees(small.yaw_radians) AS yaw_degrees
FROM (
    SELECT *, count(*) OVER (PARTITION BY model_id, category, room_type, box_size) AS alike_scenes
    FROM syntheses
) AS drawn
LEFT JOIN synthesis_objects AS small USING (scene_id)
ORDER BY
    drawn.alike_scenes DESC, drawn.category, drawn.room_type, drawn.box_size, drawn.model_id, drawn.seed, drawn.number, drawn.scene_id,
    small.instance_id
