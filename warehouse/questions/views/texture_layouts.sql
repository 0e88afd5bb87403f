-- What are the layouts of textures worth, by who made them?
-- Version 2.
-- Medians over assets. source is what models of others came with. stretch_l2 and stretch_linf are 1 without distortion (Sander et al.
-- 2001); overlap_share is of what a layout covers that shows more than one place of the surface: mean, since most have none.
SELECT
    method,
    made_by,
    count(*) AS assets,
    quantile_cont(faces, 0.5) AS median_faces,
    quantile_cont(charts, 0.5) AS median_charts,
    quantile_cont(stretch_l2, 0.5) AS median_stretch_l2,
    quantile_cont(stretch_linf, 0.5) AS median_stretch_linf,
    degrees(quantile_cont(angle_distortion_radians, 0.5)) AS median_angle_distortion_degrees,
    quantile_cont(coverage, 0.5) AS median_coverage,
    avg(overlap_share) AS mean_overlap_share,
    quantile_cont(seam_ratio, 0.5) AS median_seam_ratio,
    quantile_cont(seconds, 0.5) AS median_seconds
FROM texture_charts
GROUP BY method, made_by
ORDER BY method, made_by
