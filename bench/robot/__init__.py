"""What a cart makes of replicas: whether it arrives, what it touches, how well it knows where it is."""
