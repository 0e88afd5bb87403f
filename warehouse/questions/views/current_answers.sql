-- Which answer of each annotator counts for each instance?
-- Version 3.
-- Of those that were accepted (view standing_answers) that of the annotator's newest batch; the others are history. A batch is as new as
-- the annotator's latest answer in it, of the scene. Instances are those of the time of the answer: the optimization finds them again by
-- their box when a scan was captured anew, this view does not.
SELECT * EXCLUDE (batch_answered_at)
FROM (
    SELECT *, max(answered_at) OVER (PARTITION BY scene_id, batch_id, annotator) AS batch_answered_at
    FROM standing_answers
)
QUALIFY row_number() OVER (
    PARTITION BY scene_id, instance_id, annotator
    ORDER BY batch_answered_at DESC, answered_at DESC, batch_id DESC
) = 1
ORDER BY scene_id, instance_id, annotator
