-- Which scenes are physically plausible, and what speaks against the others?
-- Version 2.
-- Plausible: nothing penetrates deeper than 2 mm, and by that engine every object was certified and every free one stays within 5 cm and
-- 5 degrees. A scene without a certificate is not. What the engine could not simulate is not certified, and, if it is free, not stable.
WITH lost AS (
    SELECT scene_id, count(*) AS lost_supports
    FROM supports
    WHERE NOT is_kept
    GROUP BY scene_id
),
implausible AS (
    SELECT scene_id, engine, count(*) AS implausible_densities
    FROM certificates
    WHERE NOT is_density_plausible
    GROUP BY scene_id, engine
)
SELECT
    optimizations.scene_id,
    optimizations.method,
    stability.engine,
    optimizations.object_count AS objects,
    stability.free,
    collision_loss.deep_pairs_after AS deep_pairs,
    stability.free - stability.stable_1cm AS unstable_1cm,
    stability.free - stability.stable_5cm AS unstable_5cm,
    stability.free - stability.stable_nudged AS unstable_nudged,
    coalesce(stability.uncertified, optimizations.object_count) AS uncertified,
    coalesce(lost.lost_supports, 0) AS lost_supports,
    coalesce(implausible.implausible_densities, 0) AS implausible_densities,
    len(optimizations.remains) AS remains,
    coalesce(collision_loss.deep_pairs_after = 0 AND stability.stable_5cm = stability.free AND stability.uncertified = 0, FALSE) AS is_plausible
FROM optimizations
LEFT JOIN collision_loss USING (scene_id)
LEFT JOIN stability USING (scene_id)
LEFT JOIN lost USING (scene_id)
LEFT JOIN implausible ON implausible.scene_id = optimizations.scene_id AND implausible.engine = stability.engine
ORDER BY optimizations.scene_id, stability.engine
