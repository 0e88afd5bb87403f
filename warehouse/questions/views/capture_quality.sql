-- What was each scan like: frames, usable poses, mesh, alignment, where the instances came from?
-- Version 1.
WITH posed AS (
    SELECT scene_id, count(*) AS kept_frames, count(pose) AS posed_frames
    FROM frames
    GROUP BY scene_id
)
SELECT
    scenes.scene_id,
    scenes.scan_format,
    scenes.frame_count,
    coalesce(posed.posed_frames, 0) AS posed_frames,
    scenes.face_count,
    scenes.segmentation,
    scenes.alignment_source,
    degrees(scenes.floor_tilt_radians) AS floor_tilt_degrees,
    shells.floor_source,
    shells.height_source,
    shells.height_m
FROM scenes
LEFT JOIN shells USING (scene_id)
LEFT JOIN posed USING (scene_id)
ORDER BY scenes.scene_id
