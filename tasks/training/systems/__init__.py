"""The learned systems, a module each."""
