-- Between which shares does the true one lie, with so many successes in so many trials?
-- Version 1.
-- A struct with low and high: Wilson's score interval (Wilson 1927), of 95 % by default (z = 1.96). NULL without trials.
-- Example: SELECT wilson_interval(count(*) FILTER (passed), count(*)) FROM export_checks
CREATE MACRO wilson_interval(successes, trials, z := 1.96) AS CASE WHEN trials > 0 THEN {
    'low': CASE WHEN successes = 0 THEN 0.0 ELSE (
        successes / trials + z * z / (2 * trials)
        - z * sqrt(successes / trials * (1 - successes / trials) / trials + z * z / (4 * trials * trials))
    ) / (1 + z * z / trials) END,
    'high': CASE WHEN successes = trials THEN 1.0 ELSE (
        successes / trials + z * z / (2 * trials)
        + z * sqrt(successes / trials * (1 - successes / trials) / trials + z * z / (4 * trials * trials))
    ) / (1 + z * z / trials) END
} END
