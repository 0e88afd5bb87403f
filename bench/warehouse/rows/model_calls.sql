-- Two calls for every object whose caption is no fallback; of the others one, to which nobody answered.
SELECT
    digest('call ' || prompt, object) AS call_id,
    'chat' AS kind,
    'captions' AS stage,
    scene_id,
    instance_id,
    'seer-1' AS model,
    '' AS model_version,
    prompt,
    left(digest('prompt', prompt), 12) AS prompt_version,
    digest('request ' || prompt, object) || '.json' AS request_blob,
    CASE WHEN is_fallback THEN 'away' ELSE 'answered' END AS outcome,
    CASE WHEN is_fallback THEN 'no answer after 4 tries: HTTP 503' END AS problem,
    CASE WHEN NOT is_fallback THEN digest('reply ' || prompt, object) || '.txt' END AS reply_blob,
    CASE WHEN NOT is_fallback THEN 400 + below(object, prompt || ' tokens', 300) END AS prompt_tokens,
    CASE WHEN NOT is_fallback THEN 40 + below(object, prompt || ' reply', 60) END AS reply_tokens,
    CASE WHEN is_fallback THEN 0.0 ELSE 0.0015 END AS cost_usd,
    0.5 + 3 * u(object, prompt || ' seconds') AS seconds,
    CASE WHEN is_fallback THEN 4 ELSE 1 + CAST(u(object, prompt || ' again') < 0.05 AS BIGINT) END AS attempts,
    0 AS lost,
    at_second(scene * 60.0) AS asked_at,
    'generated' AS run
FROM (
    SELECT *, u(object, 'fallback') < 0.04 AS is_fallback, unnest(['appearance', 'physics']) AS prompt
    FROM objects_now
)
WHERE prompt = 'appearance' OR NOT is_fallback
