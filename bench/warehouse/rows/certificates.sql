-- MuJoCo judges every object in two settings, Newton those of the annotated scenes.
SELECT
    scene_id,
    instance_id,
    engine,
    CASE engine WHEN 'newton' THEN '1.0.0 (XPBD)' ELSE '4.0.0' END AS engine_version,
    2.0 AS simulated_seconds,
    is_fixed,
    CASE WHEN is_refused THEN 'the engine found no inertia' END AS problem,
    CASE WHEN NOT is_refused THEN displacement END AS displacement_m,
    CASE WHEN NOT is_refused THEN displacement * 0.8 END AS tilt_radians,
    CASE WHEN NOT is_refused THEN round(0.002 * u(object, 'start depth'), 4) END AS start_penetration_m,
    NOT is_refused AND displacement <= 0.01 AS is_stable_1cm,
    NOT is_refused AND displacement <= 0.05 AS is_stable_5cm,
    CASE WHEN NOT is_refused AND engine <> 'newton' THEN displacement * 1.5 END AS nudged_displacement_m,
    CASE WHEN NOT is_refused AND engine <> 'newton' THEN displacement END AS nudged_tilt_radians,
    CASE WHEN engine <> 'newton' THEN NOT is_refused AND displacement * 1.5 <= 0.01 END AS is_stable_nudged,
    CASE WHEN NOT is_refused THEN pose(yaw, x, y + displacement, 0.0) END AS settled_pose,
    greatest(0.001, density * solid_fraction * volume) AS mass_kg,
    0.3 * volume AS solid_volume_m3,
    greatest(0.001, density * solid_fraction * volume) / (0.3 * volume) AS density_kg_m3,
    0.01 * density_low AS density_low_kg_m3,
    density_high AS density_high_kg_m3,
    greatest(0.001, density * solid_fraction * volume) / (0.3 * volume) BETWEEN 0.01 * density_low AND density_high AS is_density_plausible
FROM (
    SELECT
        *,
        u(object, 'refused') < 0.001 AS is_refused,
        u(object, 'relation') >= 0.80 AND u(object, 'relation') < 0.995 AS is_fixed,
        CASE
            WHEN is_fixed THEN 0.0 WHEN u(object, 'falls') < 0.02 THEN round(0.3 * u(object, 'fall'), 3)
            ELSE round(0.004 * u(object, 'settles'), 4)
        END AS displacement
    FROM (
        SELECT *, unnest(CASE WHEN is_annotated(scene) THEN ['mujoco', 'mujoco_defaults', 'newton'] ELSE ['mujoco', 'mujoco_defaults'] END) AS engine
        FROM objects_now
    )
)
