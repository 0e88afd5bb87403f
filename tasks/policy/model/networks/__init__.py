"""Networks of policies, in torch."""
