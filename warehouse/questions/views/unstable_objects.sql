-- Which objects are not known to stay where they were put, and what carries them?
-- Version 3.
-- First all that the engine could not simulate, then the free ones that moved by more than 1 cm or tilted by more than 5 degrees,
-- left alone or after a nudge; is_stable_5cm is false for those that fail at 5 cm or 5 degrees when left alone.
SELECT
    certificates.scene_id,
    certificates.instance_id,
    certificates.engine,
    instances.category,
    supports.relation AS support,
    supports.parent_id,
    certificates.displacement_m,
    degrees(certificates.tilt_radians) AS tilt_degrees,
    certificates.start_penetration_m,
    certificates.nudged_displacement_m,
    degrees(certificates.nudged_tilt_radians) AS nudged_tilt_degrees,
    certificates.is_stable_5cm,
    certificates.problem,
    placements.remains
FROM certificates
LEFT JOIN instances USING (scene_id, instance_id)
LEFT JOIN supports USING (scene_id, instance_id)
LEFT JOIN placements USING (scene_id, instance_id)
WHERE certificates.problem IS NOT NULL
    OR (
        NOT certificates.is_fixed
        AND NOT (certificates.is_stable_1cm AND certificates.is_stable_5cm AND coalesce(certificates.is_stable_nudged, TRUE))
    )
ORDER BY certificates.displacement_m DESC NULLS FIRST, certificates.scene_id, certificates.instance_id, certificates.engine
