"""Comparing datasets by the policies that learn from them."""
