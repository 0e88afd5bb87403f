"""What models and the tools around them are worth, measured."""
