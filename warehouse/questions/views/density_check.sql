-- Of which categories are the densities outside of what is plausible for the material?
-- Version 1.
-- Mass over the volume of the convex pieces; one certificate per object, MuJoCo's where there is one, else that of the first engine by
-- name. Plausible reaches from 1 % of the least density of the lightest material (0.4 % for fabric and foliage: objects are hollow) to the
-- greatest of the densest. Without a known material, mass or volume there is no verdict.
WITH weighed AS (
    SELECT scene_id, instance_id, is_density_plausible, density_kg_m3, density_low_kg_m3, density_high_kg_m3
    FROM certificates
    WHERE engine = 'mujoco'
    UNION ALL
    SELECT
        others.scene_id,
        others.instance_id,
        others.is_density_plausible,
        others.density_kg_m3,
        others.density_low_kg_m3,
        others.density_high_kg_m3
    FROM certificates AS others
    WHERE others.engine <> 'mujoco'
        AND NOT EXISTS (
            SELECT 1
            FROM certificates AS first
            WHERE first.engine = 'mujoco' AND first.scene_id = others.scene_id AND first.instance_id = others.instance_id
        )
    QUALIFY row_number() OVER (PARTITION BY others.scene_id, others.instance_id ORDER BY others.engine) = 1
)
SELECT
    instances.category,
    count(*) AS objects,
    count(*) FILTER (NOT weighed.is_density_plausible) AS implausible,
    count(*) FILTER (weighed.is_density_plausible IS NULL) AS without_verdict,
    count(*) FILTER (NOT weighed.is_density_plausible AND weighed.density_kg_m3 < weighed.density_low_kg_m3) AS too_light,
    count(*) FILTER (NOT weighed.is_density_plausible AND weighed.density_kg_m3 > weighed.density_high_kg_m3) AS too_heavy,
    min(nullif(weighed.density_kg_m3, 0)) AS least_density_kg_m3,
    quantile_cont(nullif(weighed.density_kg_m3, 0), 0.5) AS median_density_kg_m3,
    max(nullif(weighed.density_kg_m3, 0)) AS greatest_density_kg_m3,
    min(weighed.density_low_kg_m3) AS allowed_from_kg_m3,
    max(weighed.density_high_kg_m3) AS allowed_to_kg_m3
FROM weighed
JOIN instances USING (scene_id, instance_id)
GROUP BY instances.category
ORDER BY implausible DESC, objects DESC, instances.category
