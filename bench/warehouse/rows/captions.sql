SELECT
    scene_id,
    instance_id,
    CASE WHEN is_fallback THEN 'classical' ELSE 'vision_language' END AS provider,
    '1' AS provider_version,
    is_fallback,
    concat('A ', color, ' ', material, ' ', category, '.') AS sentence,
    [color, 'gray'] AS colors,
    [0.8, 0.2] AS color_shares,
    [material] AS materials,
    CASE WHEN size_z > 2 * size_x THEN 'column' WHEN size_x > 2 * size_z THEN 'slab' ELSE 'block' END AS shape,
    body_type,
    density AS density_kg_m3,
    solid_fraction,
    greatest(0.001, density * solid_fraction * volume) AS mass_kg,
    friction,
    restitution,
    category AS attribute_source,
    CASE WHEN NOT is_fallback THEN digest('call appearance', object) END AS appearance_call_id,
    CASE WHEN NOT is_fallback THEN digest('call physics', object) END AS physics_call_id
FROM (
    SELECT
        *,
        u(object, 'fallback') < 0.04 AS is_fallback,
        ['brown', 'white', 'black', 'gray', 'blue', 'red', 'green', 'beige'][1 + below(object, 'color', 8)] AS color
    FROM objects_now
)
