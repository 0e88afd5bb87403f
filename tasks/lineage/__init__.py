"""Lineage: what exported files say of where their things are from, and graphs as text and pictures. Values in, values out."""
