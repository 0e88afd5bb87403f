"""What a policy costs: pictures, steps, and learning."""
