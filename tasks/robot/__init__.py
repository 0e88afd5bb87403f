"""Robot: a cart that drives an agent's way through a replica, simulated with noise, slip, delay and things that were moved."""
