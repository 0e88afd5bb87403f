"""What learned synthesis is measured on: generated rooms whose tops follow stated rules."""
