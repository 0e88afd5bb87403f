"""The policy's model: a network shaped as SPOC's early fusion of pictures and text, at the published size and at one that trains here."""
