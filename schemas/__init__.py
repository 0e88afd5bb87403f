"""What a row is. One file per stage; imports nothing of ours outside this folder."""
