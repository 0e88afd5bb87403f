"""What leaves the lake: exports, and explanations of what they were made from."""
