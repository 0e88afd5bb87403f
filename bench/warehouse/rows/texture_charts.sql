-- Layouts that the library's models came with.
SELECT
    asset_id,
    NULL AS of_asset_id,
    'source' AS method,
    NULL AS made_by,
    256 << below(asset_id, 'side', 4) AS side_px,
    200 + below(asset_id, 'faces', 40000) AS faces,
    1 + below(asset_id, 'charts', 200) AS charts,
    1.0 + 0.5 * u(asset_id, 'stretch') AS stretch_l2,
    1.5 + 8.0 * u(asset_id, 'stretch') AS stretch_linf,
    0.3 * u(asset_id, 'angles') AS angle_distortion_radians,
    0.3 + 0.6 * u(asset_id, 'coverage') AS coverage,
    0.2 * greatest(u(asset_id, 'overlap') - 0.5, 0.0) AS overlap,
    0 AS flipped,
    below(asset_id, 'outside', 3) AS outside,
    0 AS collapsed,
    2.0 + 20.0 * u(asset_id, 'seams') AS seam_ratio,
    NULL AS seconds
FROM library
WHERE first_part = getvariable('part') AND provider <> 'procedural' AND u(asset_id, 'texture') < 0.3
