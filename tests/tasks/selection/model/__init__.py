"""Tests of the learned selection."""
