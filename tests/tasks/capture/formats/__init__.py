"""Scans as people have them: every format that is read against the native one."""
