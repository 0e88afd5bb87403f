"""The benchmark of the alignment: objects whose poses are known, seen in part, and each method held against the truth."""
