"""Colliders that give way to one another and reach what carries them, so that objects stay where they were scanned."""
