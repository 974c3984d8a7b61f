"""Two units with unequal periods taking turns in one thread, one tick each turn."""

import pytest

from hil.canbus.memory import MemoryChannel
from hil.node.process import build_node, receive_ids

TICK_NS = 5_000_000


class Steps:
    """A unit that only counts its steps."""

    receives = ()
    probes = ()

    def __init__(self, name, node, after, period_ns):
        self.name, self.nodes, self.after, self.period_ns = name, (node,), after, period_ns
        self.at_ns = []

    def step(self, now_ns, inbox, outbox):
        self.at_ns.append(now_ns)

    def probe(self):
        return ()

    def stop(self, outbox):
        pass

    def warm_up(self):
        pass


@pytest.mark.parametrize(("first_ticks", "second_ticks"), [(1, 1), (2, 1), (1, 4), (3, 2)])
def test_each_steps_on_its_own_multiples_and_none_waits_for_the_next_tick(
    contract, first_ticks, second_ticks
):
    channel = MemoryChannel()
    bench = channel.link()
    units = [
        Steps("first", "ATO", (), first_ticks * TICK_NS),
        Steps("second", "TCU", ("ATO_SyncDone",), second_ticks * TICK_NS),
    ]
    nodes = [
        build_node(
            unit,
            channel.link(receive_ids(unit, contract, "lockstep")),
            contract,
            clock="lockstep",
            tick_ns=TICK_NS,
        )
        for unit in units
    ]
    sync, done = contract.message("SYNC"), contract.message("TCU_SyncDone")
    for tick in range(12):
        bench.send(sync.can_id, sync.encode({"Tick": tick}))
        for node in nodes:
            assert node.cycle()
        answers = [frame for frame in bench.drain() if frame.can_id == done.can_id]
        assert [int(done.decode(frame.data)["Tick"]) for frame in answers] == [tick]
    for unit, ticks in zip(units, (first_ticks, second_ticks), strict=True):
        assert unit.at_ns == [tick * TICK_NS for tick in range(0, 12, ticks)]
