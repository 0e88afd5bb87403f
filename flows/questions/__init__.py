"""Questions to a lake in SQL: what one may take, and a prompt to type them at."""
