"""Policies that act without torch."""
