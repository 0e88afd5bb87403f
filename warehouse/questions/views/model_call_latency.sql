-- How long do models take to answer?
-- Version 1.
-- Wall time with tries and pauses, of calls that were answered. mean_retries: requests beyond the first.
SELECT
    model,
    model_version,
    prompt,
    count(*) AS calls,
    quantile_cont(seconds, 0.5) AS median_seconds,
    quantile_cont(seconds, 0.95) AS p95_seconds,
    max(seconds) AS slowest_seconds,
    avg(attempts - 1) AS mean_retries,
    sum(reply_tokens) / nullif(sum(seconds), 0) AS reply_tokens_per_second
FROM model_calls
WHERE outcome = 'answered'
GROUP BY model, model_version, prompt
ORDER BY model, model_version, prompt
