"""How good a choice is where the truth is known (specs C.5): places of the true candidate, and how far what was chosen is from it.

Pure functions of arrays; every draw is seeded.
"""
