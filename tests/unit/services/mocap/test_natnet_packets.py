"""NatNet's packets. Each byte here is written down from OptiTrack's description of the bit stream."""

from __future__ import annotations

import random

import pytest

from services.mocap import natnet
from services.mocap.natnet import Captured, Kind, MalformedPacket, Seen, Server


def packet(text: str) -> bytes:
    """The bytes of a text of hexadecimal digits with comments."""
    return bytes.fromhex("".join(line.partition("#")[0] for line in text.splitlines()))


BODIES = """
    02000000                                # two rigid bodies
    01000000                                # number 1
    0000c03f 0000803e 000000c0              # at 1.5, 0.25, -2
    00000000 f304353f 00000000 f304353f     # x y z w: a quarter turn about y
    6f12833a                                # error of the markers, 0.001
    0100                                    # tracked
    02000000                                # number 2
    00000000 00000000 00000000
    00000000 00000000 00000000 00000000
    00000000
    0000                                    # not tracked
"""
MARKER = """
    01000100                                # marker 1 of model 1
    00000000 00000000 00000000              # at the origin
    cdcc4c3c                                # 12.5 mm
    0a00                                    # solved, of a model
    00000000                                # no residual
"""
FRAME_3 = packet(f"""
    0700 e800                               # a frame, 232 bytes
    04030201                                # number 16909060
    01000000 616c6c00                       # one set of markers, "all"
    01000000 0000803f 00000040 00004040     # of one marker, at 1, 2, 3
    01000000 0000803f 00000040 00004040     # one marker of no set
    {BODIES}
    00000000                                # no skeletons
    01000000 {MARKER}
    01000000                                # one force plate
    07000000 01000000                       # number 7, of one channel
    02000000 0000803f 00000040              # with two values
    00000000                                # no devices
    00000000 00000000                       # time code
    0000000000002940                        # 12.5 s since the stream began
    40420f0000000000                        # exposed at tick 1000000
    60900f0000000000                        # received at 1020000
    9005100000000000                        # sent at 1050000
    0200                                    # the list of models has changed
    00000000                                # the end
""")
FRAME_4_1 = packet(f"""
    0700 4001                               # a frame, 320 bytes
    04030201                                # number 16909060
    01000000 14000000 616c6c00              # one set of markers of 20 bytes, "all"
    01000000 0000803f 00000040 00004040     # of one marker, at 1, 2, 3
    00000000 00000000                       # no marker of no set
    02000000 4c000000 {BODIES.replace("02000000                                # two", "# two")}
    00000000 00000000                       # no skeletons
    01000000 4c000000                       # one asset of 76 bytes
    05000000                                # number 5
    01000000                                # with one rigid body
    09000000 0000803f 0000803f 0000803f
    00000000 00000000 00000000 0000803f 00000000 0100
    01000000 {MARKER}                       # and one marker
    01000000 1a000000 {MARKER}
    00000000 00000000                       # no force plates
    00000000 00000000                       # no devices
    00000000 00000000                       # time code
    0000000000002940                        # 12.5 s since the stream began
    40420f0000000000                        # exposed at tick 1000000
    60900f0000000000                        # received at 1020000
    9005100000000000                        # sent at 1050000
    10000000 20000000                       # precision time, s and parts of it
    0000                                    # parameters
    00000000                                # the end
""")
HALF = 0.7071067690849304
"""f304353f."""
SHOWN = {
    1: Seen((1.5, 0.25, -2.0), (HALF, 0.0, HALF, 0.0), True),
    2: Seen((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), False),
}
SERVER_3 = packet(f"""
    0100 1701                               # the server's answer, 279 bytes
    4d6f74697665 {"00" * 250}               # "Motive" in 256 bytes
    02010000                                # Motive 2.1
    03000000                                # NatNet 3.0
    8096980000000000                        # 10000000 ticks per second
    e705                                    # frames on port 1511
    01 efff2a63                             # by multicast to 239.255.42.99
""")
SERVER_4 = packet(f"""
    0100 1701
    4d6f74697665 {"00" * 250}
    03010000                                # Motive 3.1
    04010000                                # NatNet 4.1
    00ca9a3b00000000                        # 1000000000 ticks per second
    e705
    00 00000000                             # to each client
""")
MARKERS = """
    01000000                                # one marker
    0000803f 00000000 00000000              # at 1, 0, 0
    0b000000                                # with label 11
"""
MODELS_3 = packet(f"""
    0500 4800                               # descriptions, 72 bytes
    02000000                                # two of them
    00000000 616c6c00 01000000 6d3100       # a set of markers, "all", with "m1"
    01000000                                # a rigid body
    70616e7468657231 00                     # "panther1"
    01000000 ffffffff                       # number 1, of no parent
    00000000 00000000 00000000              # no offset
    {MARKERS}
""")
MODELS_4_2 = packet(f"""
    0500 8100                               # descriptions, 129 bytes
    03000000                                # three of them
    06000000 04000000 deadbeef              # an asset of four bytes
    01000000 41000000                       # a rigid body of 65 bytes
    43616e2031 00                           # "Can 1"
    02000000 ffffffff                       # number 2, of no parent
    00000000 00000000 00000000              # no offset
    00000000 00000000 00000000 0000803f     # not turned
    {MARKERS}
    6d3100                                  # named "m1"
    05000000 20000000                       # a camera of 32 bytes
    4361 6d00                               # "Cam"
    00000000 00000000 00000000 00000000 00000000 00000000 0000803f
""")


def payload(whole: bytes, kind: Kind) -> bytes:
    found, content = natnet.opened(whole)
    assert found == kind
    assert len(content) == len(whole) - 4
    return content


def test_a_frame_of_protocol_3() -> None:
    seen = natnet.frame(payload(FRAME_3, Kind.FRAME), (3, 0))
    assert seen == Captured(16909060, SHOWN, 1_000_000, 1_050_000, True)


def test_a_frame_of_protocol_4() -> None:
    seen = natnet.frame(payload(FRAME_4_1, Kind.FRAME), (4, 1))
    assert seen == Captured(16909060, SHOWN, 1_000_000, 1_050_000, False)


def test_a_server_of_protocol_3_and_one_of_4() -> None:
    three = natnet.server(payload(SERVER_3, Kind.SERVER_INFO))
    assert three == Server("Motive", (3, 0), 10_000_000, 1511, "239.255.42.99")
    assert natnet.server(payload(SERVER_4, Kind.SERVER_INFO)) == Server("Motive", (4, 1), 10**9, 1511, None)


def test_names_of_rigid_bodies_in_both_protocols() -> None:
    assert natnet.names(payload(MODELS_3, Kind.MODELS), (3, 0)) == [(1, "panther1")]
    assert natnet.names(payload(MODELS_4_2, Kind.MODELS), (4, 2)) == [(2, "Can 1")]


def test_a_server_that_speaks_an_older_protocol_is_refused_by_name() -> None:
    old = SERVER_3.replace(bytes.fromhex("0201000003000000"), bytes.fromhex("010a0000020a0000"))
    with pytest.raises(MalformedPacket, match=r"NatNet 2\.10"):
        natnet.server(payload(old, Kind.SERVER_INFO))


def test_questions_to_a_server() -> None:
    assert natnet.request(Kind.CONNECT) == bytes.fromhex("0000 0100 00")
    assert natnet.request(Kind.REQUEST_MODELS) == bytes.fromhex("0400 0100 00")
    assert natnet.echo_request(258) == bytes.fromhex("0c00 0800 0201000000000000")
    assert natnet.echoed(bytes.fromhex("0201000000000000 0300000000000000")) == (258, 3)


PACKETS = {
    "frame 3": (FRAME_3, lambda content: natnet.frame(content, (3, 0))),
    "frame 4.1": (FRAME_4_1, lambda content: natnet.frame(content, (4, 1))),
    "server": (SERVER_3, natnet.server),
    "models 3": (MODELS_3, lambda content: natnet.names(content, (3, 0))),
    "models 4.2": (MODELS_4_2, lambda content: natnet.names(content, (4, 2))),
}


@pytest.mark.parametrize("name", PACKETS)
def test_a_packet_that_is_cut_off_anywhere_is_malformed(name: str) -> None:
    whole, read = PACKETS[name]
    for length in range(len(whole)):
        with pytest.raises(MalformedPacket):
            natnet.opened(whole[:length])
    # Nothing is read of the tag of a frame's end, and only some versions have the eight bytes before it.
    needed = len(whole) - 4 - {"frame 3": 4, "frame 4.1": 14}.get(name, 0)
    for length in range(needed):
        with pytest.raises(MalformedPacket):
            read(whole[4 : 4 + length])


@pytest.mark.parametrize("name", PACKETS)
def test_whatever_the_bytes_are_a_packet_is_read_or_malformed(name: str) -> None:
    whole, read = PACKETS[name]
    chance = random.Random(0)
    malformed = 0
    for _ in range(3000):
        changed = bytearray(whole)
        for _ in range(chance.randint(1, 8)):
            changed[chance.randrange(4, len(changed))] = chance.randrange(256)
        try:
            read(bytes(changed[4:]))
        except MalformedPacket:
            malformed += 1
    assert malformed > 0


def test_a_count_of_billions_costs_nothing() -> None:
    content = bytearray(FRAME_3[4:])
    content[4:8] = b"\xff" * 4
    with pytest.raises(MalformedPacket, match="more is announced"):
        natnet.frame(bytes(content), (3, 0))


@pytest.mark.parametrize("value", ["0000c07f", "0000807f", "ffff7f7f"], ids=["NaN", "infinite", "too far"])
def test_a_pose_that_is_none_was_not_seen(value: str) -> None:
    whole = FRAME_3.replace(bytes.fromhex("0000c03f"), bytes.fromhex(value))
    assert not natnet.frame(whole[4:], (3, 0)).bodies[1].tracked


def test_a_stream_with_y_up_is_turned_so_that_z_is() -> None:
    """Motive's x east, y up, z south: its 1.5, 0.25, -2 is 2 m north, and 0.25 m above the floor."""
    turned = natnet.z_up(SHOWN[1])
    assert turned.position_m == (1.5, 2.0, 0.25)
    assert turned.quaternion == (HALF, 0.0, 0.0, HALF)
