"""What a lake can be asked: SQL, views, macros, and the forms of answers."""
