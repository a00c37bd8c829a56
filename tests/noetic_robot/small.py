"""A small graph of ROS 1: it tells, a JSON object a line, what it hears, and does what standard input says.

wallet NAME      call /lab/panther1/get_wallet
goal SECONDS     send a trajectory to /far/follow_joint_trajectory
cancel           cancel that goal
frame NAME       publish this frame on /tf_static
"""

from __future__ import annotations

import json
import sys
import threading
from typing import Any

import actionlib
import rospy
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped, Twist
from move_base_msgs.msg import MoveBaseAction, MoveBaseFeedback, MoveBaseResult
from nav_msgs.msg import Odometry
from std_srvs.srv import SetBool, SetBoolResponse
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectoryPoint

from rodeo_msgs.srv import GetWallet


def tell(**said: Any) -> None:
    print(json.dumps(said), flush=True)


def on_stop(request: Any) -> Any:
    if not request.data:
        raise rospy.ServiceException("the brake hangs")
    return SetBoolResponse(success=True, message="stopped")


def on_diagnostics(message: Any) -> None:
    for status in message.status:
        values = {pair.key: pair.value for pair in status.values}
        tell(diagnostics=status.name, level=status.level, message=status.message, **values)


class MoveBase:
    """Rejects goals at negative x, ends at once at small ones, and stays under way beyond 100 m."""

    def __init__(self) -> None:
        self._server = actionlib.ActionServer("/move_base", MoveBaseAction, self._begin, self._cancel, False)
        self._server.start()

    def _begin(self, handle: Any) -> None:
        goal = handle.get_goal()
        x_m = goal.target_pose.pose.position.x
        if x_m < 0:
            handle.set_rejected(text="behind the wall")
            return
        handle.set_accepted()
        handle.publish_feedback(MoveBaseFeedback(base_position=goal.target_pose))
        if x_m < 100:
            handle.set_succeeded(MoveBaseResult())

    def _cancel(self, handle: Any) -> None:
        tell(cancelled=handle.get_goal().target_pose.pose.position.x)
        handle.set_canceled(MoveBaseResult())


class Far:
    """The client of an action that ROS 2 serves."""

    def __init__(self) -> None:
        self._client = actionlib.ActionClient("/far/follow_joint_trajectory", FollowJointTrajectoryAction)
        self._handle: Any = None

    def send(self, seconds: float) -> None:
        goal = FollowJointTrajectoryGoal()
        goal.trajectory.joint_names = ["waist"]
        point = JointTrajectoryPoint(positions=[0.5], time_from_start=rospy.Duration(seconds))
        goal.trajectory.points = [point]
        self._client.wait_for_server()
        self._handle = self._client.send_goal(goal, self._on_transition, self._on_feedback)

    def cancel(self) -> None:
        self._handle.cancel()

    def _on_transition(self, handle: Any) -> None:
        if handle.get_comm_state() == actionlib.CommState.DONE:
            result = handle.get_result()
            tell(ended=handle.get_goal_status(), text=handle.get_goal_status_text(), said=result.error_string)

    def _on_feedback(self, _handle: Any, feedback: Any) -> None:
        tell(feedback=list(feedback.joint_names))


def ask_wallet(name: str) -> None:
    rospy.wait_for_service("/lab/panther1/get_wallet")
    try:
        answer = rospy.ServiceProxy("/lab/panther1/get_wallet", GetWallet)(account=[name])
        (found,) = answer.answer
        tell(wallet=list(found.name), balance=found.balance_iec)
    except rospy.ServiceException as error:
        tell(refused=str(error))


def publish_odometry() -> None:
    odometry = rospy.Publisher("/odom", Odometry, queue_size=10)
    number = 0
    rate = rospy.Rate(50)
    while not rospy.is_shutdown():
        number += 1
        message = Odometry(child_frame_id="panther1/base_link")
        message.header.frame_id = "panther1/odom"
        message.header.stamp = rospy.Time(number, 123456789)
        message.twist.twist.linear.x = 0.25
        odometry.publish(message)
        rate.sleep()


def main() -> None:
    rospy.init_node("small")
    rospy.Service("/emergency_stop", SetBool, on_stop)
    rospy.Subscriber("/cmd_vel", Twist, lambda message: tell(cmd_vel=message.linear.x))
    rospy.Subscriber("/diagnostics", DiagnosticArray, on_diagnostics)
    frames = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
    frames.publish(TFMessage([TransformStamped(child_frame_id="lidar")]))
    MoveBase()
    far = Far()
    threading.Thread(target=publish_odometry, daemon=True).start()
    tell(up=True)
    for line in sys.stdin:
        word, *rest = line.split()
        if word == "wallet":
            ask_wallet(rest[0])
        elif word == "goal":
            far.send(float(rest[0]))
        elif word == "frame":
            frames.publish(TFMessage([TransformStamped(child_frame_id=rest[0])]))
        else:
            far.cancel()


if __name__ == "__main__":
    main()
