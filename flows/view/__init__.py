"""Scenes in the browser: one page, served to whoever has its address or written as a file that opens without a server."""
