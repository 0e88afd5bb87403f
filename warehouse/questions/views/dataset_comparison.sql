-- How do the datasets of the lake compare: scenes, objects, categories, sizes, licenses, stability?
-- Version 2.
-- A finished dataset that was imported (formats metascenes and habitat) has no scans of its own here; what it does not state is missing.
-- Stability is MuJoCo's verdict on the objects that are free to move; known_share is that of objects whose label the label map has. The
-- dataset is the first word of scene_id: joining tables of millions of rows with scenes takes twice as long. categories counts those that
-- the label map has, assets those that are placed; licenses are those of scans and of placed assets (view
-- asset_licenses), unknown where nobody stated one.
WITH counted AS (
    SELECT
        split_part(scene_id, '/', 1) AS dataset,
        count(DISTINCT category) FILTER (nyu40_id > 0) AS categories,
        count(*) AS objects,
        count(*) FILTER (nyu40_id > 0) AS known,
        quantile_cont(box_volume_m3, [0.25, 0.5, 0.75]) AS volumes
    FROM instances
    WHERE NOT is_structure
    GROUP BY ALL
),
per_scene AS (
    SELECT scene_id, count(*) AS objects
    FROM instances
    WHERE NOT is_structure
    GROUP BY scene_id
),
scanned AS (
    SELECT
        split_part(scenes.scene_id, '/', 1) AS dataset,
        list_sort(list(DISTINCT scenes.scan_format)) AS formats,
        count(*) AS scenes,
        count(DISTINCT scenes.room_id) AS rooms,
        list_sort(list(DISTINCT stated_license(scenes.license))) AS licenses,
        quantile_cont(shells.floor_area_m2, 0.5) AS median_floor_area_m2,
        quantile_cont(coalesce(per_scene.objects, 0), 0.5) AS median_objects_per_scene
    FROM scenes
    LEFT JOIN shells USING (scene_id)
    LEFT JOIN per_scene USING (scene_id)
    GROUP BY ALL
),
used AS (
    SELECT
        split_part(scene_id, '/', 1) AS dataset,
        asset_id,
        count(*) AS uses,
        count(displacement_m) AS moves,
        sum(displacement_m) AS moved_m
    FROM placements
    GROUP BY ALL
),
placed AS (
    SELECT
        used.dataset,
        count(*) AS assets,
        CAST(sum(used.uses) AS BIGINT) AS placed_objects,
        sum(used.moved_m) / nullif(sum(used.moves), 0) AS mean_displacement_m,
        list_sort(list(DISTINCT held.license)) AS licenses,
        quantile_cont(assets.volume_m3, 0.5) AS median_asset_volume_m3
    FROM used
    JOIN assets USING (asset_id)
    JOIN asset_licenses AS held USING (asset_id)
    GROUP BY used.dataset
),
certified AS (
    SELECT
        split_part(scene_id, '/', 1) AS dataset,
        count(*) AS free_objects,
        count(*) FILTER (is_stable_1cm) AS stable_1cm,
        count(*) FILTER (is_stable_5cm) AS stable_5cm
    FROM certificates
    WHERE engine = 'mujoco' AND NOT is_fixed
    GROUP BY ALL
)
SELECT
    scanned.dataset,
    scanned.formats,
    scanned.scenes,
    scanned.rooms,
    scanned.median_floor_area_m2,
    coalesce(counted.objects, 0) AS objects,
    coalesce(counted.objects, 0) / scanned.scenes AS objects_per_scene,
    scanned.median_objects_per_scene,
    coalesce(counted.categories, 0) AS categories,
    counted.known / counted.objects AS known_share,
    counted.volumes[1] AS q1_box_volume_m3,
    counted.volumes[2] AS median_box_volume_m3,
    counted.volumes[3] AS q3_box_volume_m3,
    coalesce(placed.placed_objects, 0) AS placed_objects,
    coalesce(placed.placed_objects, 0) / nullif(counted.objects, 0) AS placed_share,
    coalesce(placed.assets, 0) AS assets,
    placed.median_asset_volume_m3,
    placed.mean_displacement_m,
    certified.free_objects,
    certified.stable_1cm / certified.free_objects AS stable_1cm_share,
    certified.stable_5cm / certified.free_objects AS stable_5cm_share,
    scanned.licenses AS scene_licenses,
    placed.licenses AS asset_licenses
FROM scanned
LEFT JOIN counted USING (dataset)
LEFT JOIN placed USING (dataset)
LEFT JOIN certified USING (dataset)
ORDER BY scanned.dataset
