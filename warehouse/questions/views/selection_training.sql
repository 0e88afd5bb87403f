-- What did people choose and rank among the candidates of an instance, beside all that selection measured of each?
-- Version 2.
-- Training data of selection models: one row for each candidate that selection aligned and each annotator whose answer counts (view
-- current_answers). is_chosen and people_rank are the labels: 1 for the choice, the places of the ranking after it, missing for what they
-- did not rank; has_no_choice: they chose nothing. split is that of the scene's room (view episode_splits): train on the one, test on the
-- other.
WITH orders AS (
    SELECT
        scene_id,
        instance_id,
        annotator,
        batch_id,
        is_simulated,
        choice,
        CASE WHEN choice IS NULL THEN [] ELSE [choice] END || list_filter(ranking, lambda asset: asset IS DISTINCT FROM choice) AS ranked
    FROM current_answers
)
SELECT
    orders.scene_id,
    orders.instance_id,
    orders.annotator,
    orders.batch_id,
    orders.is_simulated,
    splits.split,
    selections.slot,
    selections.asset_id,
    candidates.provider,
    candidates.is_fallback,
    instances.category,
    lower(assets.category) = instances.category AS is_category_match,
    instances.box_volume_m3,
    instances.point_count,
    assets.extents[1] * assets.extents[2] * assets.extents[3] * selections.scale[1] * selections.scale[2] * selections.scale[3]
        / nullif(instances.box_volume_m3, 0) AS size_ratio,
    selections.score,
    selections.rank,
    selections.chamfer_m,
    selections.coverage,
    selections.box_iou,
    selections.foreign_share,
    selections.color_similarity,
    coalesce(selections.asset_id = orders.choice, false) AS is_chosen,
    CAST(nullif(list_position(orders.ranked, selections.asset_id), 0) AS BIGINT) AS people_rank,
    orders.choice IS NULL AS has_no_choice
FROM orders
JOIN selections USING (scene_id, instance_id)
JOIN instances USING (scene_id, instance_id)
JOIN scenes ON scenes.scene_id = orders.scene_id
LEFT JOIN splits ON splits.room_id = scenes.room_id
LEFT JOIN assets ON assets.asset_id = selections.asset_id
LEFT JOIN candidates
    ON candidates.scene_id = orders.scene_id AND candidates.instance_id = orders.instance_id AND candidates.slot = selections.slot
ORDER BY orders.scene_id, orders.instance_id, orders.annotator, selections.rank
