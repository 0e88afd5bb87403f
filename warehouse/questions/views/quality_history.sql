-- Which annotation batches were reviewed, how many of their answers were wrong, and what became of them?
-- Version 2.
-- One row per review, in the order of time within a batch; a batch that nobody reviewed has one row without a review. wrong_low to
-- wrong_high is Wilson's interval of 95 % of the share of wrong answers in the batch, from those that were sampled; pass_low to pass_high
-- the exact one of the right answers, which knows how many there are. handed_in_round: how often the answers had been handed in.
-- What the batch is at now is in annotation_batch_states.
WITH batches AS (
    SELECT
        batch_id,
        count(DISTINCT (scene_id, instance_id, annotator)) AS answers,
        count(DISTINCT annotator) AS annotators,
        count(DISTINCT scene_id) AS scenes,
        max(answered_at) AS answered_until
    FROM annotations
    GROUP BY batch_id
),
reviewed AS (
    SELECT
        * EXCLUDE (round, answers),
        round AS handed_in_round,
        row_number() OVER rounds AS round,
        lead(review_id) OVER rounds IS NULL AS is_last
    FROM quality_reviews
    WINDOW rounds AS (PARTITION BY batch_id ORDER BY reviewed_at, review_id)
)
SELECT
    batch_id,
    batches.answers,
    batches.annotators,
    batches.scenes,
    batches.answered_until,
    reviewed.round,
    reviewed.review_id,
    reviewed.reviewer,
    reviewed.reviewed_at,
    reviewed.sampled,
    reviewed.wrong,
    reviewed.sampled / batches.answers AS sampled_share,
    reviewed.wrong / reviewed.sampled AS wrong_share,
    wilson_interval(reviewed.wrong, reviewed.sampled).low AS wrong_low,
    wilson_interval(reviewed.wrong, reviewed.sampled).high AS wrong_high,
    reviewed.verdict,
    reviewed.is_last,
    reviewed.note,
    reviewed.handed_in_round,
    reviewed.pass_low,
    reviewed.pass_high
FROM batches
FULL JOIN reviewed USING (batch_id)
ORDER BY batch_id, reviewed.round
