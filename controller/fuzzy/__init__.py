"""Fuzzy systems: rule bases declared readably, and their compiled form for the control loop."""
