"""Lineage: what an object in the lake was made from, walked along the rows of one snapshot. Every id on the way is followed."""
