"""Networks of synthesis models, in torch."""
