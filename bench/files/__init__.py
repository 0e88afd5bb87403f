"""Model files by others, as each reader of the project and as independent judges read them."""
