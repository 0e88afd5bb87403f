"""The search for an arrangement in which nothing collides."""
