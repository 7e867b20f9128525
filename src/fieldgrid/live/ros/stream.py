"""What the topics of a node say, as a source of a live session."""

from __future__ import annotations

from fieldgrid.live.intake import Intake
from fieldgrid.live.ros.head import Head
from fieldgrid.live.ros.place import RobotFrames
from fieldgrid.live.sources.mcap_stream import FIXES, McapStream, StreamChannel
from fieldgrid.live.sources.orientation_stream import ATTITUDE
from fieldgrid.recordings import TF, TF_STATIC, decode

_POLL_S = 0.25
_TAKEN = {"cloud", "imu", "odometry", ATTITUDE, *FIXES}


class RosStream(McapStream):
    """The messages that a node takes, read as those of an MCAP, with frames of any kind that a bag
    has. Until it has caught up with what came before the session began, nothing is dropped."""

    name = "ROS"

    def __init__(self, head: Head, robot: RobotFrames, epoch_ns: int | None = None) -> None:
        named = (ATTITUDE, "imu")
        given = {role: topic for topic, role in head.roles.items() if role in named}
        super().__init__("-", head.frames, given, imu_axes=head.imu_axes, epoch_ns=epoch_ns)
        self._head, self._robot = head, robot
        self._is_behind = True

    def run(self, intake: Intake) -> None:
        """Give what comes; see `InputSource`."""
        while not intake.stop.is_set():
            message = self._head.take(_POLL_S)
            if message is None:
                continue
            intake.arrived()
            if self._is_behind and not len(self._head):
                intake.live.drain()
                self._is_behind = len(self._head) > 0
            connection, role = message.connection, self._head.roles.get(message.topic, "")
            if connection.type in TF:
                role = ""
                if not message.topic.endswith(TF_STATIC):
                    self._robot.moved(decode(message))
            roles = (role,) if role in _TAKEN else ()
            self.take(StreamChannel(connection, roles), message, intake)
            if left_out := self._head.left_out:
                self._say(intake, f"gives images faster than they are taken; {left_out} are lost.")
