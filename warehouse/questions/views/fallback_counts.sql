-- Which providers answered, and how often only as a fallback?
-- Version 1.
SELECT
    'captions' AS stage,
    provider,
    provider_version,
    count(*) AS answers,
    count(*) FILTER (is_fallback) AS fallbacks
FROM captions
GROUP BY provider, provider_version
UNION ALL
SELECT
    'candidates' AS stage,
    provider,
    provider_version,
    count(*) AS answers,
    count(*) FILTER (is_fallback) AS fallbacks
FROM candidates
GROUP BY provider, provider_version
ORDER BY stage, provider, provider_version
