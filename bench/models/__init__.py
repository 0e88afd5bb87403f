"""What models of a library are worth: how well scans find them again."""
