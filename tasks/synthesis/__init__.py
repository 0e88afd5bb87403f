"""Micro-scene synthesis: models that draw what stands on a large object, and scenes made of what they draw (supplementary, B.2)."""
