"""The page of the report: cards of scenes, charts in its text, its template with style and script."""
