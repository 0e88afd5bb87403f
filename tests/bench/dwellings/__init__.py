"""The benchmark of wild rooms."""
