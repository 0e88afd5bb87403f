"""glTF features beyond plain triangles: one table of them, and plain GLBs made from files that use them."""
