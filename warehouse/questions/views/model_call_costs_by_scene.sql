-- What did the calls cost that each scene was the first to need?
-- Version 2.
-- A call is made once for the whole lake: another scene that asks the same is given its reply.
SELECT
    scene_id,
    stage,
    count(*) AS calls,
    count(*) FILTER (outcome <> 'answered') AS unanswered,
    CAST(sum(prompt_tokens) AS BIGINT) AS prompt_tokens,
    CAST(sum(reply_tokens) AS BIGINT) AS reply_tokens,
    sum(cost_usd) AS cost_usd,
    sum(seconds) AS seconds
FROM model_calls
GROUP BY scene_id, stage
ORDER BY scene_id, stage
