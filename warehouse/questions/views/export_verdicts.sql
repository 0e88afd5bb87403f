-- Which scenes are exported to which format, and do the exports pass their checks?
-- Version 1.
WITH files AS (
    SELECT scene_id, format, count(*) AS files, CAST(sum(size_bytes) AS BIGINT) AS size_bytes
    FROM export_files
    GROUP BY scene_id, format
),
verdicts AS (
    SELECT scene_id, format, count(*) AS rules, count(*) FILTER (NOT passed) AS broken_rules
    FROM export_checks
    GROUP BY scene_id, format
)
SELECT
    scene_id,
    format,
    coalesce(files.files, 0) AS files,
    coalesce(files.size_bytes, 0) AS size_bytes,
    coalesce(verdicts.rules, 0) AS rules,
    coalesce(verdicts.broken_rules, 0) AS broken_rules,
    coalesce(files.files > 0 AND verdicts.broken_rules = 0, FALSE) AS passed
FROM files
FULL JOIN verdicts USING (scene_id, format)
ORDER BY scene_id, format
