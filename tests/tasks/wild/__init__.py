"""Tests of wild rooms and their scans."""
