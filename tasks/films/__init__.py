"""Films of agents: what an agent saw at each step of its way, and the room from above in which it goes (supplementary, Fig. A12)."""
