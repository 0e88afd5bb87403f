-- How good are the scenes that synthesis models drew?
-- Version 2.
-- One row per model and dataset that its scenes are rows of; objects are the small ones that were drawn.
-- category_kl (CKL, in nats): sum over categories of p (ln(p + 1e-6) - ln(q + 1e-6)); q are shares of categories among the drawn objects,
-- p those among the small objects of all other micro-scenes of the lake, each category of large ones weighted as often as it was drawn on.
-- Large categories of which there is no other micro-scene are left out on both sides.
-- colliding_ and off_support_ are of the boxes as drawn, and so are drawn_stable_: MuJoCo leaves the object within 1 cm and 5 degrees.
-- placed_colliding_share is of the objects whose assets, as proposed, go deeper than 5 mm into another drawn object's. settled_stable_ are
-- the certificate's after all was put right. A scene is stable when all its drawn objects are; what nobody simulated is not. Moves are
-- from the proposed to the optimized place of the asset's origin, height included.
WITH drawn AS (
    SELECT * EXCLUDE (instance_id), split_part(scene_id, '/', 1) AS dataset
    FROM syntheses
),
scanned AS (
    SELECT category, count(*) AS micro_scenes
    FROM micro_scenes
    WHERE scene_id NOT IN (SELECT scene_id FROM syntheses)
    GROUP BY category
),
scanned_small AS (
    SELECT micro.category AS large_category, small.category, count(*) AS objects
    FROM micro_scenes AS micro
    JOIN micro_scene_objects AS small ON small.scene_id = micro.scene_id AND small.large_id = micro.instance_id
    WHERE micro.scene_id NOT IN (SELECT scene_id FROM syntheses)
    GROUP BY micro.category, small.category
),
truth AS (
    SELECT model_id, dataset, category, expected / sum(expected) OVER (PARTITION BY model_id, dataset) AS share
    FROM (
        SELECT
            asked.model_id,
            asked.dataset,
            scanned_small.category,
            sum(asked.scenes * scanned_small.objects / scanned.micro_scenes) AS expected
        FROM (SELECT model_id, dataset, category, count(*) AS scenes FROM drawn GROUP BY ALL) AS asked
        JOIN scanned USING (category)
        JOIN scanned_small ON scanned_small.large_category = asked.category
        GROUP BY ALL
    )
),
drawn_shares AS (
    SELECT
        drawn.model_id, drawn.dataset, small.category,
        count(*) / sum(count(*)) OVER (PARTITION BY drawn.model_id, drawn.dataset) AS share
    FROM drawn
    JOIN synthesis_objects AS small USING (scene_id)
    WHERE drawn.category IN (SELECT category FROM scanned)
    GROUP BY drawn.model_id, drawn.dataset, small.category
),
divergences AS (
    SELECT
        truth.model_id, truth.dataset,
        sum(truth.share * (ln(truth.share + 1e-6) - ln(coalesce(drawn_shares.share, 0) + 1e-6))) AS category_kl
    FROM truth
    LEFT JOIN drawn_shares USING (model_id, dataset, category)
    WHERE (truth.model_id, truth.dataset) IN (SELECT (model_id, dataset) FROM drawn_shares)
    GROUP BY ALL
),
deep AS (
    SELECT DISTINCT pair.scene_id, unnest([pair.instance_a, pair.body_b]) AS instance_id
    FROM contacts AS pair
    JOIN synthesis_objects AS a ON a.scene_id = pair.scene_id AND a.instance_id = pair.instance_a
    JOIN synthesis_objects AS b ON b.scene_id = pair.scene_id AND b.instance_id = pair.body_b
    WHERE pair.phase = 'proposed' AND pair.penetration_m > 0.005
),
certified AS (
    SELECT scene_id, instance_id, is_stable_1cm
    FROM certificates
    WHERE engine = 'mujoco' AND scene_id IN (SELECT scene_id FROM syntheses)
),
followed AS (
    SELECT
        drawn.model_id,
        drawn.dataset,
        small.scene_id,
        deep.instance_id IS NOT NULL AS is_deep,
        placed.instance_id IS NOT NULL AS is_placed,
        coalesce(small.is_stable, false) AS was_stable,
        coalesce(certified.is_stable_1cm, false) AS is_stable,
        sqrt(placed.displacement_m ** 2 + placed.lift_m ** 2) AS move_m
    FROM drawn
    JOIN synthesis_objects AS small USING (scene_id)
    LEFT JOIN deep USING (scene_id, instance_id)
    LEFT JOIN placements AS placed USING (scene_id, instance_id)
    LEFT JOIN certified USING (scene_id, instance_id)
),
per_scene AS (
    SELECT scene_id, bool_and(was_stable) AS was_stable, bool_and(is_stable) AS is_stable
    FROM followed
    GROUP BY scene_id
),
per_model AS (
    SELECT
        model_id, dataset,
        count(*) FILTER (is_placed) / count(*) AS placed_share,
        count(*) FILTER (is_deep) / nullif(count(*) FILTER (is_placed), 0) AS placed_colliding_share,
        count(*) FILTER (was_stable) / count(*) AS drawn_stable_share,
        count(*) FILTER (is_stable) / count(*) AS settled_stable_share,
        quantile_cont(move_m, 0.5) AS median_move_m,
        quantile_cont(move_m, 0.95) AS p95_move_m
    FROM followed
    GROUP BY ALL
),
counted AS (
    SELECT
        drawn.model_id,
        drawn.dataset,
        any_value(drawn.model_kind) AS model_kind,
        count(*) AS scenes,
        CAST(sum(drawn.object_count) AS BIGINT) AS objects,
        sum(drawn.colliding_count) / nullif(sum(drawn.object_count), 0) AS colliding_share,
        count(*) FILTER (drawn.colliding_count > 0) / count(*) AS colliding_scene_share,
        sum(drawn.off_support_count) / nullif(sum(drawn.object_count), 0) AS off_support_share,
        count(*) FILTER (drawn.off_support_count > 0) / count(*) AS off_support_scene_share,
        count(*) FILTER (per_scene.was_stable) / nullif(count(per_scene.scene_id), 0) AS drawn_stable_scene_share,
        count(*) FILTER (per_scene.is_stable) / nullif(count(per_scene.scene_id), 0) AS settled_stable_scene_share,
        avg(drawn.seconds) AS seconds_per_scene
    FROM drawn
    LEFT JOIN per_scene USING (scene_id)
    GROUP BY ALL
)
SELECT
    counted.model_id,
    counted.model_kind,
    counted.dataset,
    counted.scenes,
    counted.objects,
    counted.objects / counted.scenes AS objects_per_scene,
    divergences.category_kl,
    counted.colliding_share,
    counted.colliding_scene_share,
    counted.off_support_share,
    counted.off_support_scene_share,
    per_model.placed_share,
    per_model.placed_colliding_share,
    per_model.drawn_stable_share,
    counted.drawn_stable_scene_share,
    per_model.settled_stable_share,
    counted.settled_stable_scene_share,
    per_model.median_move_m,
    per_model.p95_move_m,
    counted.seconds_per_scene
FROM counted
LEFT JOIN per_model USING (model_id, dataset)
LEFT JOIN divergences USING (model_id, dataset)
ORDER BY counted.dataset, counted.model_kind, counted.model_id
