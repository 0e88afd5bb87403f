"""Instances of depth frames without labels, by geometry alone: neighbors of the image, planes, patches, local convexity."""
