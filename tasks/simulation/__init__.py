"""Scenes to act in: one small protocol of simulators, our own on rows of the lake and habitat-sim, and object navigation on either."""
