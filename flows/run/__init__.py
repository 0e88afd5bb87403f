"""One run: what it is told, what it would do, its workers, and what came of it."""
