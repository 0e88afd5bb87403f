"""Pages of the documentation that are written from the code of this room: settings and commands."""
