"""Files of a lake, in a folder or in a store of objects."""
