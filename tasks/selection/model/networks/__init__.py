"""Networks of the learned selection, in torch."""
