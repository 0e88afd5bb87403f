-- Layouts that the library's models came with; of every second dozen, those of twins of one asset, by two unwrappers.
SELECT
    asset_id,
    CASE WHEN is_twin THEN digest('library asset', library_index - library_index % 24 + 1) END AS of_asset_id,
    CASE WHEN NOT is_twin THEN 'source' WHEN library_index % 2 = 0 THEN 'xatlas' ELSE 'smart_uv' END AS method,
    CASE WHEN is_twin THEN 'unwrapper 1.0' END AS made_by,
    256 << below(asset_id, 'side', 4) AS side_px,
    200 + below(asset_id, 'faces', 40000) AS faces,
    1 + below(asset_id, 'charts', 200) AS charts,
    1.0 + 0.5 * u(asset_id, 'stretch') AS stretch_l2,
    1.5 + 8.0 * u(asset_id, 'stretch') AS stretch_linf,
    0.3 * u(asset_id, 'angles') AS angle_distortion_radians,
    0.3 + 0.6 * u(asset_id, 'coverage') AS coverage,
    0.2 * greatest(u(asset_id, 'overlap') - 0.5, 0.0) AS overlap_share,
    0 AS flipped,
    below(asset_id, 'outside', 3) AS outside,
    0 AS collapsed,
    2.0 + 20.0 * u(asset_id, 'seams') AS seam_ratio,
    CASE WHEN is_twin THEN 0.5 + u(asset_id, 'laid out') END AS seconds
FROM (SELECT *, library_index % 24 >= 12 AS is_twin FROM library)
WHERE first_part = getvariable('part') AND provider <> 'procedural' AND u(asset_id, 'texture') < 0.3
