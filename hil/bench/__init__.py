"""The bench: scenario in, processes started and watched, verdict out.

It starts nodes by command line, or through entry points where they share one process; it imports
neither the controller nor the plant, so either can be replaced by a real one.
"""
