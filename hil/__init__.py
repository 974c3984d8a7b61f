"""ATO-HIL bench: a train's automatic operation, its drives and its line, as processes on one CAN bus."""

__version__ = "0.1.0"
