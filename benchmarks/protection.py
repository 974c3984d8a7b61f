"""E2E: what protecting and judging a frame costs, beside the bare CRC of autosar-e2e."""

from __future__ import annotations

import e2e.p01

from benchmarks.rows import Row, in_turns_us
from hil.canbus.contract import Contract
from hil.canbus.protection import Protector, Receiver


def measure() -> list[Row]:
    codec = Contract.load().message("ODO_Motion")
    if codec.protection is None:
        raise RuntimeError("ODO_Motion is not protected")
    protector, receiver = Protector(codec.protection), Receiver(codec.protection, length=codec.length)
    data, data_id = codec.encode({}), codec.protection.data_id
    protect = in_turns_us(lambda: protector.protect(data), lambda: e2e.p01.e2e_p01_protect(data, data_id))

    def fresh() -> object:
        protector.protect(data)
        return receiver.check(data)

    both = in_turns_us(fresh, lambda: e2e.p01.e2e_p01_check(data, data_id))
    return [
        Row("protect: counter and CRC", *protect, "us", "autosar-e2e p01 protect"),
        Row("protect, then check by the state machine", *both, "us", "autosar-e2e p01 check, CRC only"),
    ]
