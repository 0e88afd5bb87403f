"""Keeping a lake small, whole and safe: compaction, vacuum, backup, inspection, erasure."""
