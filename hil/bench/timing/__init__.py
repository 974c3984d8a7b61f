"""Timing validation: the bench's own loop and the whole bench beside cyclictest, in the same minutes.

`measure` runs the parts in short slices in shuffled order; `judge` holds what was measured against limits.
"""
