"""Layouts from trained synthesis models with NumPy alone: networks, noise schedules, guidance by physics, sampling."""
