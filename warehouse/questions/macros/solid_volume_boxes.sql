-- How large are the solids of the n categories that are placed most often, as a box plot shows it?
-- Version 1.
-- Rows of the view solid_volume_by_category.
-- Example: FROM solid_volume_boxes(50)
CREATE MACRO solid_volume_boxes(n := 50) AS TABLE
SELECT *
FROM solid_volume_by_category
WHERE frequency_rank <= n
ORDER BY frequency_rank
