-- Which license holds for each asset?
-- Version 2.
-- That of its scan where it was cut from one (assets.license is LicenseRef-scan then) and beside that of the model where it was painted with
-- one, unknown where nobody stated it. In no order: there may be millions. Exports, data cards and attributions say the same.
SELECT
    assets.asset_id,
    CASE
        WHEN assets.license = 'LicenseRef-scan' THEN stated_license(scenes.license)
        WHEN regexp_matches(assets.license, '(^|[\s()])LicenseRef-scan($|[\s()])') THEN replace(
            assets.license,
            'LicenseRef-scan',
            CASE WHEN regexp_matches(scenes.license, '\sOR\s', 'i') THEN '(' || scenes.license || ')' ELSE stated_license(scenes.license) END
        )
        ELSE stated_license(assets.license)
    END AS license
FROM assets
LEFT JOIN scenes
    ON contains(assets.license, 'LicenseRef-scan')
    AND scenes.scene_id = split_part(regexp_replace(assets.source, '^scan ', ''), '; ', 1)
