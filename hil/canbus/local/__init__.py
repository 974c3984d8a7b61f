"""The local bus, python-can interface `hil`: a hub process per channel, clients over a stream socket.

::

    can.Bus(interface="hil", channel="ato")        # any python-can program; starts the hub if there is none
    python -m hil.canbus.local --channel ato       # a hub of one's own

`wire.py` is the format both sides speak, `address.py` where a channel's hub is found, `filters.py` what a
client wants to receive, `hub.py` the process in the middle, `link.py` how a client joins (and starts a hub),
`client.py` the python-can interface. The hub imports neither python-can nor numpy: it starts quickly.

With a bit rate (`--bitrate`, `rates.py`) `timed.py` lets the frames through `medium.py`, the model of the
wire: `bits.py` their exact length, `confinement.py` error counters and bus-off, `disturbance.py` errors made
on purpose, `traffic.py` the load, `credit.py` the sender's transmit queue.
"""
