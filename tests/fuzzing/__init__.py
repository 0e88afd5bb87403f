"""Fuzzing of everything that reads files of others: sound inputs, changed in many ways, read in children with limits."""
