"""The server of `metascenes annotate serve`: what a batch asks, shown to whoever has a token of it, and what they answer and judge.

It changes the lake by `flows.inputs.annotation` alone, whose gate lies in the warehouse. Drafts are kept beside the lake's tables.
"""
