"""Commands about learned systems and their models."""
