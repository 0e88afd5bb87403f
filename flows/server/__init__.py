"""Prefect servers of ours: processes, access, deployments, notifications, and what their UI shows."""
