# SPDX-License-Identifier: Apache-2.0
"""An unsecured participant of Cyclone DDS, alone in its process: ``python unsecured.py DOMAIN`` and a line of JSON.

The line on standard input says what it is: ``{"name": …, "user_data": …, "edges": [[permission, topic, partitions]]}``.
It answers ``READY``, and ends with its input.
Only ctypes is used, so that this needs neither headers nor a compiler.
"""

from __future__ import annotations

import ctypes
import json
import sys
from ctypes import POINTER, Structure, c_char_p, c_int32, c_size_t, c_uint32, c_void_p
from typing import Any

LIBRARY = "libddsc.so.0debian"
STRING_OPS = (0x01050000, 0, 0)
"""Marshalling of one string at offset 0: DDS_OP_ADR | DDS_OP_TYPE_STR, its offset, DDS_OP_RTS."""


class Blob(Structure):
    _fields_ = [("data", c_void_p), ("size", c_uint32)]


class Descriptor(Structure):
    """``dds_topic_descriptor_t`` of Cyclone DDS 0.10."""

    _fields_ = [
        ("size", c_uint32),
        ("align", c_uint32),
        ("flags", c_uint32),
        ("keys", c_uint32),
        ("type_name", c_char_p),
        ("key_descriptors", c_void_p),
        ("op_count", c_uint32),
        ("ops", POINTER(c_uint32)),
        ("meta", c_char_p),
        ("type_information", Blob),
        ("type_mapping", Blob),
        ("representation", c_uint32),
    ]


class Participant:
    """A participant and its edges."""

    def __init__(self, domain: int, what: dict[str, Any]) -> None:
        self.dds = ctypes.CDLL(LIBRARY)
        self.dds.dds_create_qos.restype = c_void_p
        ops = (c_uint32 * 3)(*STRING_OPS)
        type_name = what.get("type", "std_msgs::msg::dds_::String_").encode()
        self.descriptor = Descriptor(8, 8, 0, 0, type_name, None, 2, ops, b"")
        qos = c_void_p(self.dds.dds_create_qos())
        if what.get("name"):
            self.dds.dds_qset_entity_name(qos, what["name"].encode())
        user_data = what.get("user_data", "").encode()
        if user_data:
            self.dds.dds_qset_userdata(qos, user_data, c_size_t(len(user_data)))
        self.entity = self.made(self.dds.dds_create_participant(c_uint32(domain), qos, None))
        self.edges = [self.edge(*edge) for edge in what["edges"]]

    def made(self, code: int) -> int:
        if code < 0:
            self.dds.dds_strretcode.restype = c_char_p
            raise SystemExit(f"refused: {self.dds.dds_strretcode(c_int32(code)).decode()}")
        return code

    def edge(self, permission: str, topic: str, partitions: list[str]) -> int:
        qos = c_void_p(self.dds.dds_create_qos())
        self.dds.dds_qset_reliability(qos, 1, ctypes.c_int64(10**9))
        self.dds.dds_qset_durability(qos, 1)
        if partitions:
            names = (c_char_p * len(partitions))(*(name.encode() for name in partitions))
            self.dds.dds_qset_partition(qos, c_uint32(len(partitions)), names)
        made = self.made(
            self.dds.dds_create_topic(self.entity, ctypes.byref(self.descriptor), topic.encode(), None, None)
        )
        create = self.dds.dds_create_writer if permission == "publish" else self.dds.dds_create_reader
        return self.made(create(self.entity, made, qos, None))


def main() -> None:
    """Run the participant that standard input describes, until standard input ends."""
    participant = Participant(int(sys.argv[1]), json.loads(sys.stdin.readline()))
    sys.stdout.write("READY\n")
    sys.stdout.flush()
    sys.stdin.read()
    participant.dds.dds_delete(participant.entity)


if __name__ == "__main__":
    main()
