"""Ingestion: finished datasets of others in; rows of the lake's tables out, which say that they were imported."""
