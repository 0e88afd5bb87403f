-- What is every annotation batch at, and do its answers reach scenes?
-- Version 1.
-- From the rows of the batch alone, as the gate sees it: open, submitted, in_review, accepted or returned. A batch that was created here
-- is accepted only if a large enough sample of exactly what was handed in was judged by others than who answered, to the end, and more
-- than pass_share of it passed. One that was made elsewhere may have been reviewed there, too, with as many that pass. counts: its answers
-- reach scenes; so do those of batches made elsewhere that nobody reviewed yet, where they were imported with
-- annotation.unreviewed_imports_count and were never returned.
WITH named AS (
    SELECT batch_id FROM annotation_batches
    UNION
    SELECT batch_id FROM annotations
    UNION
    SELECT batch_id FROM submissions
    UNION
    SELECT batch_id FROM review_samples
    UNION
    SELECT batch_id FROM answer_verdicts
    UNION
    SELECT batch_id FROM quality_reviews
),
rounds AS (
    SELECT
        named.batch_id,
        coalesce(any_value(batches.origin), 'elsewhere') AS origin,
        coalesce(any_value(batches.sample_share), 0.1) AS sample_share,
        coalesce(any_value(batches.least_sample), 50) AS least_sample,
        coalesce(any_value(batches.pass_share), 0.98) AS pass_share,
        coalesce(any_value(batches.counts_unreviewed), false) AS counts_unreviewed,
        coalesce(max(submissions.round), CASE WHEN any_value(batches.origin) = 'created' THEN 0 ELSE 1 END) AS round
    FROM named
    LEFT JOIN annotation_batches AS batches USING (batch_id)
    LEFT JOIN submissions USING (batch_id)
    GROUP BY named.batch_id
),
handed_in_scenes AS (
    SELECT
        batch_id,
        count(*) AS handed_in,
        max(answers) AS answers,
        sha256(
            string_agg(concat_ws('|', scene_id, instance_id, annotator, revision), chr(10) ORDER BY instance_id, annotator)
        ) AS hash
    FROM submissions
    SEMI JOIN rounds USING (batch_id, round)
    GROUP BY batch_id, scene_id
),
handed_in AS (
    SELECT batch_id, CAST(sum(handed_in) AS BIGINT) AS handed_in, max(answers) AS answers, list(hash) AS hashes
    FROM handed_in_scenes
    GROUP BY batch_id
),
verdicts AS (
    SELECT batch_id, scene_id, instance_id, annotator, arg_max(passes, number) AS passes
    FROM answer_verdicts
    SEMI JOIN rounds USING (batch_id, round)
    WHERE lower(trim(reviewer)) <> lower(trim(annotator))
    GROUP BY batch_id, scene_id, instance_id, annotator
),
sampled AS (
    SELECT
        samples.batch_id,
        count(*) AS left_of_sample,
        max(samples.sampled) AS sampled,
        count(*) FILTER (submissions.revision IS NULL) AS strangers,
        count(verdicts.passes) AS judged,
        count(*) FILTER (verdicts.passes) AS passed
    FROM review_samples AS samples
    SEMI JOIN rounds USING (batch_id, round)
    LEFT JOIN submissions USING (batch_id, round, scene_id, instance_id, annotator, revision)
    LEFT JOIN verdicts USING (batch_id, scene_id, instance_id, annotator)
    GROUP BY samples.batch_id
),
ever_returned AS (
    SELECT DISTINCT batch_id FROM quality_reviews WHERE verdict = 'returned'
),
reviewed AS (
    SELECT
        batch_id,
        last(verdict ORDER BY reviewed_at, review_id) AS verdict,
        last(handed_in_hashes ORDER BY reviewed_at, review_id) AS hashes,
        last(sampled ORDER BY reviewed_at, review_id) AS sampled,
        last(wrong ORDER BY reviewed_at, review_id) AS wrong,
        max(reviewed_at) AS reviewed_at,
        bool_or(verdict = 'returned') AS was_returned
    FROM quality_reviews
    SEMI JOIN rounds USING (batch_id, round)
    GROUP BY batch_id
),
facts AS (
    SELECT
        rounds.*,
        coalesce(handed_in.handed_in, 0) AS handed_in,
        coalesce(sampled.left_of_sample, 0) AS sampled,
        coalesce(sampled.judged, 0) AS judged,
        coalesce(sampled.passed, 0) AS passed,
        reviewed.reviewed_at AS concluded_at,
        rounds.counts_unreviewed AND ever_returned.batch_id IS NULL AS is_trusted,
        reviewed.verdict = 'returned' OR (rounds.origin = 'created' AND reviewed.was_returned) AS is_returned,
        reviewed.verdict = 'accepted'
            AND coalesce(list_has_all(reviewed.hashes, coalesce(handed_in.hashes, [])), rounds.origin = 'elsewhere')
            AND (
                (
                    rounds.origin = 'elsewhere'
                    AND sampled.sampled IS NULL
                    AND reviewed.sampled - reviewed.wrong - rounds.pass_share * reviewed.sampled > 1e-9
                )
                OR (
                    sampled.sampled >= greatest(
                        1,
                        least(
                            coalesce(handed_in.answers, 0),
                            greatest(
                                CAST(ceil(rounds.sample_share * coalesce(handed_in.answers, 0) - 1e-9) AS BIGINT), rounds.least_sample
                            )
                        )
                    )
                    AND sampled.strangers = 0
                    AND sampled.judged = sampled.left_of_sample
                    AND CASE
                        WHEN sampled.left_of_sample = sampled.sampled
                            THEN sampled.passed - rounds.pass_share * sampled.sampled > 1e-9
                        ELSE sampled.sampled - sampled.left_of_sample BETWEEN 1 AND handed_in.answers - handed_in.handed_in
                            AND reviewed.sampled = sampled.sampled
                            AND sampled.judged - sampled.passed <= reviewed.wrong
                            AND sampled.sampled - reviewed.wrong - rounds.pass_share * sampled.sampled > 1e-9
                    END
                )
            ) AS is_accepted
    FROM rounds
    LEFT JOIN handed_in USING (batch_id)
    LEFT JOIN sampled USING (batch_id)
    LEFT JOIN reviewed USING (batch_id)
    LEFT JOIN ever_returned USING (batch_id)
),
decided AS (
    SELECT
        *,
        CASE
            WHEN round = 0 THEN 'open'
            WHEN is_returned THEN 'returned'
            WHEN is_accepted THEN 'accepted'
            WHEN sampled > 0 THEN 'in_review'
            ELSE 'submitted'
        END AS state
    FROM facts
)
SELECT
    batch_id,
    origin,
    state,
    round,
    state = 'accepted' OR (origin = 'elsewhere' AND is_trusted AND state IN ('submitted', 'in_review')) AS counts,
    handed_in,
    sampled,
    judged,
    passed,
    judged - passed AS failed,
    sample_share,
    least_sample,
    pass_share,
    CASE WHEN state IN ('accepted', 'returned') THEN concluded_at END AS concluded_at
FROM decided
ORDER BY batch_id
