"""The room of a scan: its frame, floor, walls and what divides it."""
