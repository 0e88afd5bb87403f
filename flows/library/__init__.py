"""Libraries of the lake: folders of models that are indexed, listed, shown and removed."""
