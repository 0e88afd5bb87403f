"""What capture makes of scans without labels, measured against what is true of them."""
