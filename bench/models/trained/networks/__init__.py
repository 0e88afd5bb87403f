"""The network as torch has it."""
