-- Has Smart UV fewer charts than xatlas: which of two unwrappers does better on the same asset?
-- Version 1.
-- Every two methods, of assets that both laid out; what one made several times for (twins of several instances) counts once. fewer, same,
-- more: assets of which method makes fewer charts than other_method, as many, or more; tighter: of which it covers more of the texture;
-- truer: of which its stretch_l2 is less.
WITH layouts AS (
    SELECT
        of_asset_id,
        method,
        min(charts) AS charts,
        max(coverage) AS coverage,
        min(stretch_l2) AS stretch_l2
    FROM texture_charts
    WHERE of_asset_id IS NOT NULL
    GROUP BY of_asset_id, method
)
SELECT
    first.method,
    other.method AS other_method,
    count(*) AS assets,
    count(*) FILTER (first.charts < other.charts) AS fewer,
    count(*) FILTER (first.charts = other.charts) AS same,
    count(*) FILTER (first.charts > other.charts) AS more,
    quantile_cont(first.charts / other.charts, 0.5) AS median_chart_ratio,
    count(*) FILTER (first.coverage > other.coverage) AS tighter,
    count(*) FILTER (first.stretch_l2 < other.stretch_l2) AS truer
FROM layouts AS first
JOIN layouts AS other USING (of_asset_id)
WHERE first.method <> other.method
GROUP BY first.method, other.method
ORDER BY first.method, other.method
