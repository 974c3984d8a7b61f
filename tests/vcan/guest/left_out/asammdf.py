"""In a guest kernel, in place of the asammdf that only tests of `hil export` need.

python-can imports it, and pandas with it, in every process where it is installed: 12 of the 29 thousand page
faults of a starting node, each of which costs a guest kernel a tenth of a millisecond.
"""

raise ImportError("left out in a guest kernel")
