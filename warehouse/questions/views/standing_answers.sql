-- Which answers were accepted, and so reach scenes?
-- Version 1.
-- Of batches that count (view annotation_batch_states) the revisions that were handed in; of batches from before answers were handed in,
-- the last ones. None of an answer that was withdrawn in the end. This is what the optimization reads.
WITH counting AS (
    SELECT states.batch_id, states.round, batches.batch_id IS NOT NULL AS is_listed
    FROM annotation_batch_states AS states
    LEFT JOIN annotation_batches AS batches USING (batch_id)
    WHERE states.counts
),
chosen AS (
    SELECT
        annotations.*,
        counting.is_listed,
        submissions.revision IS NOT NULL AS was_handed_in,
        max(annotations.revision) FILTER (annotations.is_withdrawn) OVER of_answer AS withdrawn,
        max(annotations.revision) OVER of_answer AS newest
    FROM annotations
    JOIN counting USING (batch_id)
    LEFT JOIN submissions
        ON submissions.batch_id = annotations.batch_id
        AND submissions.round = counting.round
        AND submissions.scene_id = annotations.scene_id
        AND submissions.instance_id = annotations.instance_id
        AND submissions.annotator = annotations.annotator
        AND submissions.revision = annotations.revision
    WINDOW of_answer AS (PARTITION BY annotations.batch_id, annotations.scene_id, annotations.instance_id, annotations.annotator)
)
SELECT * EXCLUDE (is_listed, was_handed_in, withdrawn, newest)
FROM chosen
WHERE NOT is_withdrawn AND revision > coalesce(withdrawn, 0) AND CASE WHEN is_listed THEN was_handed_in ELSE revision = newest END
ORDER BY batch_id, scene_id, instance_id, annotator
