"""Models that others generate: what a generator is asked, and how what it answers becomes an asset."""
