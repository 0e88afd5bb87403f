"""Whole scenes for tests: rows in every table, which name one another as a pipeline's rows do, made in milliseconds."""

from bench.samples import INSTANCES, stage_batch, stage_whole_scene

__all__ = ["INSTANCES", "stage_batch", "stage_whole_scene"]
