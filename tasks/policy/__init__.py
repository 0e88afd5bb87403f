"""Policies that are learned: what an agent does next, of what its camera saw last and what it is sent to (supplementary B.3)."""
