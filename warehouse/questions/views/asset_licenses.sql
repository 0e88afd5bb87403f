-- Which license holds for each asset?
-- Version 1.
-- That of its scan where it was cut from one (assets.license is LicenseRef-scan then), unknown where nobody stated it. In no order: there
-- may be millions. Exports, data cards and attributions say the same.
SELECT
    assets.asset_id,
    CASE
        WHEN assets.license = 'LicenseRef-scan' THEN stated_license(scenes.license)
        ELSE stated_license(assets.license)
    END AS license
FROM assets
LEFT JOIN scenes
    ON assets.license = 'LicenseRef-scan'
    AND scenes.scene_id = regexp_replace(assets.source, '^scan ', '')
