"""Lineage: what exported files say of where their objects are from, and graphs as text and pictures. Values in, values out."""
