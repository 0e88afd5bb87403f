-- How near do the assets of each category come to what was scanned of their objects, the least near first?
-- Version 1.
-- An object without an asset has completeness and F-scores of 0; of one whose asset no camera could see accuracy and F-scores are missing,
-- and unseen counts it.
SELECT
    instances.category,
    count(*) AS objects,
    count(*) FILTER (fidelity.is_placed) AS placed,
    count(*) FILTER (fidelity.is_placed AND fidelity.f_5cm IS NULL) AS unseen,
    avg(fidelity.f_2cm) AS mean_f_2cm,
    avg(fidelity.f_5cm) AS mean_f_5cm,
    avg(fidelity.f_10cm) AS mean_f_10cm,
    min(fidelity.f_5cm) AS least_f_5cm,
    avg(fidelity.completeness_5cm) AS mean_completeness_5cm,
    avg(fidelity.accuracy_5cm) AS mean_accuracy_5cm,
    avg(fidelity.seen_empty_share) AS mean_seen_empty_share,
    avg(fidelity.in_others_share) AS mean_in_others_share,
    avg(fidelity.color_difference) AS mean_color_difference
FROM fidelity
JOIN instances USING (scene_id, instance_id)
GROUP BY instances.category
ORDER BY mean_f_5cm NULLS LAST, instances.category
