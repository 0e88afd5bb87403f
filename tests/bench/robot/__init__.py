"""The benchmark of carts."""
