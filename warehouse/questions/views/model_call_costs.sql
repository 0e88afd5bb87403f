-- What do calls to models cost?
-- Version 2.
-- Of every model, prompt and version of these. requests: that were sent, with those that were sent again; lost: calls that were under
-- way when their process died. cost_usd: tokens times the prices of the settings; servers at home cost nothing.
SELECT
    model,
    model_version,
    prompt,
    prompt_version,
    count(*) AS calls,
    count(*) FILTER (outcome = 'answered') AS answered,
    count(*) FILTER (outcome = 'refused') AS refused,
    count(*) FILTER (outcome = 'away') AS away,
    CAST(sum(attempts) AS BIGINT) AS requests,
    CAST(sum(lost) AS BIGINT) AS lost,
    CAST(sum(prompt_tokens) AS BIGINT) AS prompt_tokens,
    CAST(sum(reply_tokens) AS BIGINT) AS reply_tokens,
    sum(cost_usd) AS cost_usd,
    sum(cost_usd) / nullif(count(*) FILTER (outcome = 'answered'), 0) AS cost_usd_per_answer
FROM model_calls
GROUP BY model, model_version, prompt, prompt_version
ORDER BY cost_usd DESC, model, model_version, prompt, prompt_version
