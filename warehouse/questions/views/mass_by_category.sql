-- How heavy are the objects of each category, and of what body type?
-- Version 1.
SELECT
    instances.category,
    count(*) AS objects,
    min(captions.mass_kg) AS lightest_kg,
    quantile_cont(captions.mass_kg, 0.5) AS median_kg,
    max(captions.mass_kg) AS heaviest_kg,
    sum(captions.mass_kg) AS total_kg,
    count(*) FILTER (captions.body_type = 'rigid') AS rigid,
    count(*) FILTER (captions.body_type = 'cloth') AS cloth,
    count(*) FILTER (captions.body_type = 'soft') AS soft
FROM captions
JOIN instances USING (scene_id, instance_id)
WHERE NOT instances.is_structure
GROUP BY instances.category
ORDER BY objects DESC, instances.category
