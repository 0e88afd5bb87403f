"""What models and their classical counterparts are worth, measured where the truth is known."""
