"""The benchmark of the warehouse: a generated lake of 100,000 scenes, and what it takes to ask it."""
