"""Scenes over workers: which are taken, in what portions, by whom, and when their rows are committed."""
