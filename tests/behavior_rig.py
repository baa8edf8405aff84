"""Behavior vectors as traces of an amplifier in C, and what it has to do on them."""

import struct

from protocol_traces import FAULT, INPUT, MARKS, PACKET, RUN, SWITCHED, Record
from vectors_rig import (
    PULSE,
    Instants,
    Vector,
    check_answers,
    check_last_pulse,
    check_output,
    check_pulses,
    config_of,
)

from firmware_protocol.packet import Packet, decode_packet


def trace(vector: Vector) -> list[Record]:
    """Return the steps of a vector as records."""
    return [_record(step) for step in vector["steps"]]


def _record(step: Vector) -> Record:
    if "packet" in step:
        return Record(step["tick"], PACKET, bytes.fromhex(step["packet"]))
    for name, kind in (("fault", FAULT), ("input", INPUT)):
        if name in step:
            return Record(step["tick"], kind, bytes([step[name]]))
    return Record(step["tick"], RUN)


def _decoded(data: bytes) -> Packet:
    packet = decode_packet(data)
    assert packet is not None
    return packet


def check_replayed(vector: Vector, out: bytes, sent: list[Record]) -> None:
    """Compare what an amplifier put out and sent on a trace with the vector.

    Parameters
    ----------
    vector : vector of the trace
    out : records of its instants, as `virtual-amplifier --out` writes them
    sent : packets, switching of the high voltage, and changes of the marker lines
    """
    row = struct.Struct(f"<QIBB{config_of(vector)['channels']}h")
    marks = [(r.tick, r.data[-1]) for r in sent if r.kind == MARKS]
    instants: Instants = {
        t: (n, s, list(codes), [0, *(lines for tick, lines in marks if tick <= t)][-1])
        for t, n, s, _, *codes in row.iter_unpack(out)
    }
    packets = [(r.tick, _decoded(r.data)) for r in sent if r.kind == PACKET]
    switched = [(r.tick, r.data[0]) for r in sent if r.kind == SWITCHED]
    since = -1
    for step in vector["steps"]:
        # steps are at different ticks, so what a step caused has its tick
        new = [(tick, packet) for tick, packet in packets if since < tick <= step["tick"]]
        check_answers(step, [packet for _, packet in new])
        if vector["pulses"]:
            check_pulses(step, [packet for _, packet in new])
            ticks = [tick for tick, packet in new if packet.type == PULSE]
            assert ticks == [p["tick"] for p in step["pulses"]], step
        check_output(step, instants)
        on = [0, *(on for tick, on in switched if tick <= step["tick"])][-1]
        assert step.get("high_voltage", on) == on, step
        since = step["tick"]
    check_last_pulse(vector, (packet for _, packet in packets))
