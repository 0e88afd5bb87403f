-- Of which categories are the densities outside of what the material allows?
-- Mass over the volume of the convex pieces; one certificate per object, whichever engine made it.
WITH weighed AS (
    SELECT *
    FROM certificates
    QUALIFY row_number() OVER (PARTITION BY scene_id, instance_id ORDER BY engine) = 1
)
SELECT
    instances.category,
    count(*) AS objects,
    count(*) FILTER (NOT weighed.is_density_plausible) AS implausible,
    count(*) FILTER (weighed.density_kg_m3 < weighed.density_low_kg_m3) AS too_light,
    count(*) FILTER (weighed.density_kg_m3 > weighed.density_high_kg_m3) AS too_heavy,
    min(weighed.density_kg_m3) AS least_density_kg_m3,
    quantile_cont(weighed.density_kg_m3, 0.5) AS median_density_kg_m3,
    max(weighed.density_kg_m3) AS greatest_density_kg_m3,
    min(weighed.density_low_kg_m3) AS allowed_from_kg_m3,
    max(weighed.density_high_kg_m3) AS allowed_to_kg_m3
FROM weighed
JOIN instances USING (scene_id, instance_id)
GROUP BY instances.category
ORDER BY implausible DESC, objects DESC, instances.category
