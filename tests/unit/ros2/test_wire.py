"""Wire: keys, tokens and attachments exactly as in rmw_zenoh's design document."""

from __future__ import annotations

import pytest

from rodeo.ros2 import wire
from rodeo.ros2.errors import MalformedMessage

STRING = "std_msgs/msg/String"
KEY_END = (
    "std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)


def test_a_topic_key_has_domain_name_type_and_hash() -> None:
    assert wire.data_key(0, "/chatter", STRING) == f"0/chatter/{KEY_END}"


def test_a_publisher_token_names_its_node_topic_type_and_qos() -> None:
    node = wire.NodeEntity(2, "aac3", 0, "", "talker")
    token = node.endpoint_token(10, "MP", "chatter", STRING, wire.DEFAULT)
    assert token == f"@ros2_lv/2/aac3/0/10/MP/%/%/talker/%chatter/{KEY_END}/::,10:,:,:,,"


def test_a_namespace_is_mangled() -> None:
    assert (
        wire.NodeEntity(0, "aac3", 3, "panther1", "sim").token() == "@ros2_lv/0/aac3/3/3/NN/%/%panther1/sim"
    )


@pytest.mark.parametrize(
    ("qos", "text"),
    [(wire.DEFAULT, "::,10:,:,:,,"), (wire.LATCHED, ":1:,1:,:,:,,"), (wire.SENSOR_DATA, "2::,5:,:,:,,")],
)
def test_qos_leaves_defaults_empty(qos: wire.QoS, text: str) -> None:
    assert qos.encode() == text


def test_an_attachment_is_33_bytes_and_reads_back() -> None:
    attachment = wire.Attachment(7, 1_700_000_000_123_456_789, bytes(range(16)))
    assert len(attachment.encode()) == 33
    assert wire.Attachment.decode(attachment.encode()) == attachment


@pytest.mark.parametrize("data", [b"", b"\x00" * 32, b"\x00" * 33])
def test_another_attachment_is_malformed(data: bytes) -> None:
    with pytest.raises(MalformedMessage):
        wire.Attachment.decode(data)
