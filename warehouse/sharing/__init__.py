"""Who is at work on a lake: the lease of the one committer, claims on scenes, presence of runs."""
