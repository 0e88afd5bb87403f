SELECT
    scene_id,
    instance_id,
    slot,
    filling.provider,
    '1' AS provider_version,
    is_fallback,
    CASE WHEN rank <= filled THEN 'filled' WHEN rank = 10 THEN 'failed' ELSE 'empty' END AS outcome,
    CASE WHEN rank > filled THEN 'nothing fits' WHEN is_fallback THEN 'the provider had nothing' END AS reason,
    CASE WHEN rank <= filled THEN asset_of(object, slot, library.asset_id) END AS asset_id,
    NULL AS seed,
    NULL AS call_id,
    CASE WHEN rank <= filled AND filling.provider = 'library' THEN 'models' END AS library,
    CASE WHEN rank <= filled AND filling.provider = 'library' THEN library.asset_id || '.glb' END AS library_file,
    CASE WHEN rank <= filled AND filling.provider = 'library' THEN 0.9 - 0.05 * (slot - 7) END AS library_score,
    CASE WHEN is_twin THEN 5 END AS twin_of,
    CASE WHEN is_twin AND rank <= filled THEN 0.2 + 0.7 * u(object * 16 + slot, 'seen') END AS seen_share,
    0.02 + 0.2 * u(object * 16 + slot, 'seconds') AS seconds
FROM (
    SELECT
        *,
        slot > 6 AND u(object * 16 + slot, 'fallback') < 0.1 AS is_fallback,
        slot = 6 AND u(object * 16 + slot, 'twin') < 0.2 AS is_twin,
        CASE
            WHEN slot < 5 OR is_fallback THEN 'procedural' WHEN slot = 5 THEN 'scan_crop_closed' WHEN is_twin THEN 'textured'
            WHEN slot = 6 THEN 'generated'
            ELSE 'library'
        END AS provider
    FROM slots_now
) AS filling
LEFT JOIN library ON library.library_index = filling.library_index
