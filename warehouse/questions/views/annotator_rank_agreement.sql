-- Do two annotators rank the candidates of the same instance alike?
-- Version 1.
-- Of each annotator the answer that counts (view current_answers), its choice on top of its ranking. Every two candidates that both ranked
-- are a pair, which they order alike or not. kendalls_tau (Kendall 1938) is what the pairs in one order outnumber the others by, over all:
-- 1 is full agreement, 0 what chance gives, -1 the reverse; missing where no pair was ranked by both.
WITH orders AS (
    SELECT
        scene_id,
        instance_id,
        annotator,
        CASE WHEN choice IS NULL THEN [] ELSE [choice] END || list_filter(ranking, lambda asset: asset IS DISTINCT FROM choice) AS ranked
    FROM current_answers
),
places AS (
    SELECT scene_id, instance_id, annotator, unnest(ranked) AS asset_id, generate_subscripts(ranked, 1) AS place
    FROM orders
),
both_ranked AS (
    SELECT scene_id, instance_id, a.annotator AS annotator_a, b.annotator AS annotator_b, asset_id, a.place AS place_a, b.place AS place_b
    FROM places AS a
    JOIN places AS b USING (scene_id, instance_id, asset_id)
    WHERE a.annotator < b.annotator
),
pairs AS (
    SELECT
        annotator_a,
        annotator_b,
        scene_id,
        instance_id,
        (x.place_a < y.place_a) = (x.place_b < y.place_b) AS is_alike
    FROM both_ranked AS x
    JOIN both_ranked AS y USING (scene_id, instance_id, annotator_a, annotator_b)
    WHERE x.asset_id < y.asset_id
)
SELECT
    annotator_a,
    annotator_b,
    count(DISTINCT (scene_id, instance_id)) AS instances,
    count(*) AS pairs,
    count(*) FILTER (is_alike) AS alike,
    (2 * count(*) FILTER (is_alike) - count(*)) / count(*) AS kendalls_tau
FROM pairs
GROUP BY annotator_a, annotator_b
ORDER BY annotator_a, annotator_b
