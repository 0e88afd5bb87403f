"""How well models of others, and what stands in for them, do their part: measured."""
