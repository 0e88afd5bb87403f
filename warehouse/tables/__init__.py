"""Rows of a lake: tables and snapshots, and how staged rows get into them."""
