"""Measurements: what the command line's `bench` prints."""
