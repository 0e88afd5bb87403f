-- One object in two hundred has no asset, and one asset in a hundred is hidden.
SELECT
    scene_id,
    instance_id,
    is_placed,
    2 * (size_x * size_y + size_y * size_z + size_z * size_x) AS scan_area_m2,
    CASE WHEN is_placed THEN CASE WHEN is_hidden THEN 0.0 ELSE 1.5 * (size_x * size_y + size_y * size_z + size_z * size_x) END END
        AS visible_area_m2,
    CASE WHEN is_placed THEN near * near ELSE 0.0 END AS completeness_2cm,
    CASE WHEN is_placed THEN near ELSE 0.0 END AS completeness_5cm,
    CASE WHEN is_placed THEN sqrt(near) ELSE 0.0 END AS completeness_10cm,
    CASE WHEN is_seen THEN near * near END AS accuracy_2cm,
    CASE WHEN is_seen THEN near END AS accuracy_5cm,
    CASE WHEN is_seen THEN sqrt(near) END AS accuracy_10cm,
    CASE WHEN is_seen THEN near * near WHEN NOT is_placed THEN 0.0 END AS f_2cm,
    CASE WHEN is_seen THEN near WHEN NOT is_placed THEN 0.0 END AS f_5cm,
    CASE WHEN is_seen THEN sqrt(near) WHEN NOT is_placed THEN 0.0 END AS f_10cm,
    CASE WHEN is_seen THEN round(0.2 * (1 - near), 4) END AS seen_empty_share,
    CASE WHEN is_seen THEN round(0.05 * (1 - near), 4) END AS in_others_share,
    CASE WHEN is_seen AND u(object, 'colored') < 0.9 THEN round(30 * u(object, 'color'), 2) END AS color_difference
FROM (
    SELECT
        *,
        u(object, 'placed') >= 0.005 AS is_placed,
        u(object, 'hidden') < 0.01 AS is_hidden,
        is_placed AND NOT is_hidden AS is_seen,
        round(1 - u(object, 'near') ** 3, 4) AS near
    FROM objects_now
)
