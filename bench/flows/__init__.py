"""The benchmark of the flows: what orchestration costs, what it does to memory, and what it stands."""
