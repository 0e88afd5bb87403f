"""Pictures of instances: crops of their best views."""
