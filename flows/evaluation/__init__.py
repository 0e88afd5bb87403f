"""Agents in the episodes of a lake: who acts, what is measured, and the flow that spreads it over workers."""
