-- How large are the scanned objects of the n most frequent categories, as a box plot shows it?
-- Version 1.
-- Rows of the view volume_by_category.
-- Example: FROM volume_boxes(50)
CREATE MACRO volume_boxes(n := 50) AS TABLE
SELECT *
FROM volume_by_category
WHERE frequency_rank <= n
ORDER BY frequency_rank
