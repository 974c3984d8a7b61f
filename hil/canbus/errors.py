"""What can go wrong with a bus, each with the exit code that a process ends with.

::

    RuntimeError
     +-- BusError               the bus is missing or died                       exit code 3
          +-- BusUnavailable    it cannot be opened: what is missing, the remedy
          +-- TransmitQueueFull a frame was refused in time: somebody reads too slowly
          +-- BusLost           it was open and has ended
    ValueError
     +-- BusOptionsError        an option of the bus has no valid value          exit code 2
"""

from __future__ import annotations


class BusError(RuntimeError):
    """Something about the bus is missing or died: what, and the remedy, in one line."""

    exit_code = 3


class BusUnavailable(BusError):
    """The bus cannot be opened: what is missing and how to get it, in one line."""


class TransmitQueueFull(BusError):
    """A frame was not taken within the sender's time limit. It was not sent, and nothing was lost."""


class BusLost(BusError):
    """The bus was open and has ended, e.g. the hub of a local bus or a network interface went down."""


class BusOptionsError(ValueError):
    """An option of the bus is wrong: which one, its value and what would be right, in one line."""

    exit_code = 2
