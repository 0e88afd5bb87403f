"""Scans: where they lie, which are chosen, which are new."""
