"""Scans of several floors: where one storey ends and the next begins, and a scan of each."""
