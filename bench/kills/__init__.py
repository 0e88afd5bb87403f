"""Kills by the hundred: small lakes whose upkeep, writers and runs die at every step, and what the lakes are worth afterwards."""
