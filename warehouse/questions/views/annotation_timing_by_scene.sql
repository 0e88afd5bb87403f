-- How many minutes did people spend on the answers for each scene, in all and per annotated object?
-- Version 1.
-- Every answer with a time counts, history too: the time was spent. objects counts instances with such an answer; minutes are missing
-- where nobody measured any.
SELECT
    scene_id,
    count(*) AS answers,
    count(seconds) AS timed_answers,
    count(DISTINCT annotator) AS annotators,
    count(DISTINCT instance_id) FILTER (seconds IS NOT NULL) AS objects,
    sum(seconds) / 60 AS minutes,
    sum(seconds) / 60 / nullif(count(DISTINCT instance_id) FILTER (seconds IS NOT NULL), 0) AS minutes_per_object
FROM annotations
GROUP BY scene_id
ORDER BY scene_id
