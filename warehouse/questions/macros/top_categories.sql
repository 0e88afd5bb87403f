-- Which n categories are the most frequent?
-- Version 1.
-- Equally frequent ones in the order of the alphabet.
-- Example: FROM top_categories(10)
CREATE MACRO top_categories(n := 50) AS TABLE
SELECT category, objects, scenes, share
FROM category_counts
ORDER BY objects DESC, category
LIMIT n
