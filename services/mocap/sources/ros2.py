"""Another driver of motion capture, which publishes over ROS 2 on the site's bus.

    source = "ros2"
    address = "vrpn_mocap/{body}/pose"  # its topic, without the leading slash

On a closed bus the driver connects with the certificate `driver.mocap`, which may publish there alone.
"""

from __future__ import annotations

from typing import Any, Literal

from rodeo.host.stamps import stamp_ns
from rodeo.ros2.base import MessageInfo
from services.mocap.sources import Frame, Opening, Pose, Settings, SourceKind

_TYPES = {"PoseStamped": "geometry_msgs/msg/PoseStamped", "TFMessage": "tf2_msgs/msg/TFMessage"}


class Chosen(Settings):
    """Settings of the source."""

    type: Literal["PoseStamped", "TFMessage"] = "PoseStamped"
    """`PoseStamped` has a topic for each body, whose name stands for `{body}` in the address."""
    frame: str = "map"
    """Frame of the poses, as the messages' headers name it. Those in another frame are not used."""


class RosDriver:
    """A `Source`: stamps are the site's time."""

    def __init__(self, opening: Opening) -> None:
        self._deliver = opening.deliver
        self._chosen: Chosen = opening.settings
        self._why = ""
        """Why the newest message cannot be used."""
        typename = _TYPES[self._chosen.type]
        if self._chosen.type == "TFMessage":
            self._subscriptions = [opening.node.subscription(opening.address, typename, self._on_transforms)]
            return
        self._subscriptions = [
            opening.node.subscription(opening.address.format(body=body), typename, self._on_pose(body))
            for body in sorted(opening.bodies)
        ]

    def _on_pose(self, body: str) -> Any:
        def on_message(message: Any, _info: MessageInfo) -> None:
            if self._usable(message.header.frame_id):
                self._hand(body, message.header.stamp, message.pose.position, message.pose.orientation)

        return on_message

    def _on_transforms(self, message: Any, _info: MessageInfo) -> None:
        for one in message.transforms:
            if self._usable(one.header.frame_id):
                turn = one.transform.rotation
                self._hand(one.child_frame_id, one.header.stamp, one.transform.translation, turn)

    def _usable(self, frame: str) -> bool:
        wanted = self._chosen.frame
        self._why = (
            "" if frame.lstrip("/") == wanted else f"its poses are in the frame {frame!r}, not {wanted!r}"
        )
        return not self._why

    def _hand(self, body: str, stamp: Any, at: Any, turn: Any) -> None:
        pose = Pose((at.x, at.y, at.z), (turn.w, turn.x, turn.y, turn.z))
        self._deliver(Frame(stamp_ns(stamp), {body: pose}))

    def problem(self) -> str:
        """See `Source`."""
        return self._why

    def close(self) -> None:
        """See `Source`."""
        for one in self._subscriptions:
            one.close()


SOURCE = SourceKind(RosDriver, Chosen, stamps="site", over_bus=True)
