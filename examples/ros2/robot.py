"""A mobile manipulator over ROS 2's standard interfaces: nothing of the organization is in here."""

import math

import numpy as np
import viperx
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory, GripperCommand
from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.task import Future
from sensor_msgs.msg import CameraInfo, Image, JointState

OPEN, SHUT, HELD, FORCE = 0.057, 0.0, 0.022, 5.0
"""From the middle to each finger, m; with less than HELD nothing is between them. Force in N."""
LOOK = 0.25
"""Height of the pads while the camera looks down, m."""


class Failed(Exception):
    """The work cannot be done."""


class Robot(Node):
    """Poses are in the frame `map`, points of the arm in the robot's own: `await self.seen(...)`."""

    def __init__(self, name):
        super().__init__(name)
        self.robot = robot = "/" + self.declare_parameter("robot", "panther1").value
        self.body = self.declare_parameter("body_pose", f"/mocap{robot}/pose").value
        self._drive = ActionClient(self, NavigateToPose, f"{robot}/navigate_to_pose")
        follow = f"{robot}/arm_controller/follow_joint_trajectory"
        self._follow = ActionClient(self, FollowJointTrajectory, follow)
        self._grip = ActionClient(self, GripperCommand, f"{robot}/gripper_controller/gripper_cmd")
        self._sighting = self.create_publisher(PoseStamped, f"{robot}/item_pose", 10)

    def wait_for_servers(self, *clients):
        """Until everybody is there whom this node asks."""
        for action in (self._drive, self._follow, self._grip):
            action.wait_for_server()
        for client in clients:
            client.wait_for_service()

    def check(self):
        """Called before each motion; raises what ends the work."""

    async def act(self, client, goal):
        """Carry a goal to its end. Raises Failed."""
        self.check()
        handle = await client.send_goal_async(goal)
        if not handle.accepted:
            raise Failed("the robot rejects a motion")
        ended = await handle.get_result_async()
        if ended.status != GoalStatus.STATUS_SUCCEEDED:
            raise Failed(f"the robot gave up a motion: {ended.result}")
        return ended.result

    def hear(self, kind, topic, skip=0):
        """A future message. The robot makes what is costly only while somebody listens."""
        heard, future = [], Future()

        def on_message(message):
            heard.append(message)
            if len(heard) == skip + 1:
                self.destroy_subscription(subscription)
                future.set_result(message)

        subscription = self.create_subscription(kind, topic, on_message, qos_profile_sensor_data)
        return future

    # -- the base --------------------------------------------------------------------------------------

    async def where(self):
        """x, y and heading of the robot."""
        return flat((await self.hear(PoseStamped, self.body)).pose)

    async def seen(self, x, y, z):
        """A point of the map as the robot sees it from where it stands."""
        own_x, own_y, heading = await self.where()
        turn = complex(x - own_x, y - own_y) * complex(math.cos(heading), -math.sin(heading))
        return np.array([turn.real, turn.imag, z])

    async def go(self, x, y, heading):
        goal = NavigateToPose.Goal()
        goal.pose.header.frame_id = "map"
        goal.pose.pose.position.x, goal.pose.pose.position.y = float(x), float(y)
        turn = goal.pose.pose.orientation
        turn.z, turn.w = math.sin(heading / 2), math.cos(heading / 2)
        await self.act(self._drive, goal)

    # -- arm and fingers -------------------------------------------------------------------------------

    async def follow(self, knots):
        await self.act(self._follow, FollowJointTrajectory.Goal(trajectory=viperx.motion(knots)))

    async def move(self, angles):
        joints = await self.hear(JointState, f"{self.robot}/joint_states")
        now = [joints.position[joints.name.index(one)] for one in viperx.JOINTS]
        if np.abs(now - angles).max() > 0.01:
            await self.follow([now, angles])

    async def lower(self, point, by, closing=viperx.ACROSS):
        """To above a point, and straight down to it."""
        await self.move(viperx.above(*viperx.raised(point, by), closing))
        await self.follow(viperx.line(viperx.raised(point, by), point, closing))

    async def lift(self, point, by, closing=viperx.ACROSS):
        await self.follow(viperx.line(point, viperx.raised(point, by), closing))

    async def grip(self, position):
        goal = GripperCommand.Goal()
        goal.command.position, goal.command.max_effort = position, FORCE
        ended = await self.act(self._grip, goal)
        if position == SHUT and ended.position < HELD:
            raise Failed("the fingers closed on nothing")

    # -- the camera ------------------------------------------------------------------------------------

    async def find(self, x, y):
        """What stands around a place of the map: its point and height in the robot's frame, and the heading
        in which the fingers close on it."""
        x, y, _ = await self.seen(x, y, 0.0)
        await self.move(viperx.above(x - viperx.CAMERA_AHEAD, y, LOOK))
        camera = f"{self.robot}/wrist_camera/depth"
        # The first picture may have been taken before the arm came to rest.
        image = self.hear(Image, f"{camera}/image_rect_raw", skip=1)
        info = await self.hear(CameraInfo, f"{camera}/camera_info")
        thing = viperx.thing_below(await image, info, LOOK)
        if thing is None:
            raise Failed("nothing stands there")
        (ahead, left), top, closing = thing
        return (x + ahead, y + left), top, closing

    async def announce(self, spot, top):
        """Say where the item is seen before it is grasped."""
        here = await self.hear(PoseStamped, self.body)
        x, y, heading = flat(here.pose)
        place = complex(x, y) + complex(*spot) * complex(math.cos(heading), math.sin(heading))
        sighting = PoseStamped(header=here.header)
        sighting.pose.position.x, sighting.pose.position.y = place.real, place.imag
        sighting.pose.position.z, sighting.pose.orientation.w = top / 2, 1.0
        self._sighting.publish(sighting)


def flat(pose):
    """x, y and heading of a pose on the floor."""
    return pose.position.x, pose.position.y, 2 * math.atan2(pose.orientation.z, pose.orientation.w)
