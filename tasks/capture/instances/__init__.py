"""Instances of a scan: found, boxed, seen in frames, made into rows."""
