-- Which license is that, where nobody stating one may be said in several ways?
-- Version 1.
-- The license as it is, or 'unknown' for NULL, '', 'unknown', 'not stated', 'noassertion' and 'none', in any case.
-- Example: SELECT stated_license(license), count(*) FROM scenes GROUP BY ALL
CREATE MACRO stated_license(license_) AS CASE
    WHEN license_ IS NULL OR lower(regexp_replace(license_, '^\s+|\s+$', '', 'g')) IN ('', 'unknown', 'not stated', 'noassertion', 'none')
        THEN 'unknown'
    ELSE license_
END
