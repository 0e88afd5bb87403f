"""Where rows live and how they are asked for: the lake, its snapshots and SQL. Imports schemas, nothing else of ours."""
