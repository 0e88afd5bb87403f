"""The benchmark of exported scenes in other physics engines, each by its own reader and in an environment of its own."""
