"""What carries what, and where objects come to rest."""
