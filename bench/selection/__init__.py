"""The benchmark of asset selection: rooms whose models are known, lineups that are hard, simulated annotators, every method."""
