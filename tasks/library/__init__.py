"""A library of models that is indexed once: what every file holds, where it comes from, and what it is found by."""
