#!/usr/bin/env python3
"""A node of ROS 2 that maps while it drives: pairs and fixes in, a costmap and a pose out.

    python3 ros2_live_node.py --ros-args -p map:=row.gpkg -p height_m:=1.9 -p tilt_deg:=16.0 \
        -r left/image_rect:=/zed/left/image_rect_gray -r fix:=/gnss/fix

It takes rectified images (as image_proc gives them) of a synchronised pair, and fixes whose stamps
are the receiver's time; images must have stamps by the same clock. Ctrl-C ends the drive and makes
its map. `fieldgrid` must be importable by the Python of ROS.

Subscribed:  left/image_rect, right/image_rect (sensor_msgs/Image), left/camera_info,
             right/camera_info (sensor_msgs/CameraInfo), fix (sensor_msgs/NavSatFix)
Published:   costmap (nav_msgs/OccupancyGrid, all of it unknown while it is not to be trusted),
             pose (geometry_msgs/PoseWithCovarianceStamped, none while there is none that is good
             enough), doubt (std_msgs/String, empty while the costmap can be trusted),
             datum (sensor_msgs/NavSatFix: where the frame `map` is, x east, y north)
"""

import array
import math
from collections import deque

import cv2
import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, NavSatFix
from std_msgs.msg import String

import fieldgrid as fg
from fieldgrid.geometry import Fix, LeverArm, Mount, Rig, Status
from fieldgrid.live import LiveEvent, LiveWindow
from fieldgrid.perception import camera_from_projections
from fieldgrid.recordings import quality_of

NANO = 1_000_000_000
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MOST_WAITING = 8
"""Images that wait for the other one of their pair."""

MOST_FIXES = 200
"""Fixes that wait for the calibrations, with which the session begins."""

CHANNELS = {"mono8": 1, "8UC1": 1, "bgr8": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4}
TO_GREY = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
}

# Costs to what Nav2 publishes for them: 1..252 to 1..98, then 99 and 100; 255 is unknown.
OCCUPANCY = np.zeros(256, dtype=np.int8)
OCCUPANCY[1:253] = 1 + 97 * np.arange(252) // 251
OCCUPANCY[253], OCCUPANCY[254], OCCUPANCY[255] = 99, 100, -1


class LiveNode(Node):
    """Pushes what comes into a live session, and publishes what it tells."""

    def __init__(self):
        super().__init__("fieldgrid_live")
        self.live = None
        self._infos, self._images, self._doubt = {}, {"left": {}, "right": {}}, None
        self._costmaps = self.create_publisher(OccupancyGrid, "costmap", LATCHED)
        self._poses = self.create_publisher(PoseWithCovarianceStamped, "pose", 10)
        self._doubts = self.create_publisher(String, "doubt", LATCHED)
        self._datums = self.create_publisher(NavSatFix, "datum", LATCHED)
        self._datum, self._fixes = None, deque(maxlen=MOST_FIXES)
        self._map = self._parameter("map", "live.gpkg")
        self._session = self._parameter("session", "ros2")
        self._append = self._parameter("append", False)
        self._frame = self._parameter("map_frame", "map")
        # How the camera sits: `fieldgrid mount` estimates the angles from a recording.
        mount = ("height_m", 1.5), ("tilt_deg", 15.0), ("roll_deg", 0.0), ("yaw_deg", 0.0)
        self._mount = Mount(*(self._parameter(name, usual) for name, usual in mount))
        # The antenna in metres right, forward and up of the middle between the two cameras, on the
        # ground; the axle that does not steer in metres forward of it, nan where it is not known.
        self._antenna = LeverArm(*self._parameter("antenna_m", [0.0, 0.0, 2.0]))
        axle_m = self._parameter("rear_axle_forward_m", math.nan)
        self._axle_m = None if math.isnan(axle_m) else axle_m
        for side in ("left", "right"):
            self._subscribe(CameraInfo, f"{side}/camera_info", self._take_info, side)
            self._subscribe(Image, f"{side}/image_rect", self._take_image, side)
        self._subscribe(NavSatFix, "fix", self._take_fix)

    def finish(self):
        """End the drive, and make its map."""
        if self.live is not None:
            self.live.close()
            self.get_logger().info(f"the map is {self._map}")

    def _parameter(self, name, usual):
        return self.declare_parameter(name, usual).value

    def _subscribe(self, kind, topic, take, *more):
        self.create_subscription(
            kind, topic, lambda message: take(message, *more), qos_profile_sensor_data
        )

    def _take_info(self, message, side):
        """The session begins when both calibrations are known."""
        self._infos.setdefault(side, message)
        if self.live is not None or len(self._infos) < 2:
            return
        left, right = (
            np.array(self._infos[side].p, dtype=np.float64).reshape(3, 4)
            for side in ("left", "right")
        )
        size_px = message.width, message.height
        camera = camera_from_projections(left, right, size_px, "camera_info")
        rig = Rig(camera, self._mount, self._antenna, self._axle_m)
        self.live = fg.Live(
            self._map, rig, name=self._session, append=self._append, on_result=self._take_result
        )
        self.get_logger().info(f"the drive is kept in {self.live.folder}")

    def _take_image(self, message, side):
        time_ns, other = stamp_ns(message), "right" if side == "left" else "left"
        partner = self._images[other].pop(time_ns, None)
        if partner is None:
            waiting = self._images[side]
            waiting[time_ns] = message
            while len(waiting) > MOST_WAITING:
                waiting.pop(min(waiting))
            return
        pair = {side: message, other: partner}
        try:
            left, right = grey(pair["left"]), grey(pair["right"])
        except ValueError as problem:
            self.get_logger().error(str(problem), throttle_duration_sec=5.0)
            return
        if self.live is not None:
            self.live.push_pair(left, right, time_ns)

    def _take_fix(self, message):
        quality, sigma_m = quality_of(message)
        place = message.latitude, message.longitude, message.altitude
        self._fixes.append(Fix(stamp_ns(message), *place, quality, sigma_m=sigma_m))
        while self.live is not None and self._fixes:
            self.live.push_fix(self._fixes.popleft())

    def _take_result(self, result):
        """Comes in a thread of the session; publishing is safe from any."""
        if isinstance(result, LiveEvent):
            self.get_logger().warning(result.text)
        elif isinstance(result, LiveWindow):
            self._publish_datum(result)
            if result.doubt != self._doubt:
                self._doubt = result.doubt
                self._doubts.publish(String(data=result.doubt))
            self._publish_pose(result)
            self._publish_costmap(result)

    def _publish_costmap(self, window):
        costmap = window.costmap
        occupancy = OCCUPANCY[costmap.costs]
        if not window.is_trusted:
            occupancy = np.full_like(occupancy, -1)
        message = OccupancyGrid()
        self._stamp(message.header, window.time_ns)
        message.info.map_load_time = message.header.stamp
        message.info.resolution = costmap.lattice.cell_m
        message.info.height, message.info.width = occupancy.shape
        message.info.origin.position.x = float(costmap.bounds.west_m)
        message.info.origin.position.y = float(costmap.bounds.south_m)
        message.info.origin.orientation.w = 1.0
        message.data = array.array("b", occupancy.tobytes())
        self._costmaps.publish(message)

    def _publish_pose(self, window):
        pose = window.pose
        if pose is None or pose.status is Status.REJECTED or not window.is_trusted:
            return
        message = PoseWithCovarianceStamped()
        self._stamp(message.header, pose.time_ns)
        yaw_rad = math.radians(90.0 - pose.heading_deg)
        message.pose.pose.position.x = float(pose.east_m)
        message.pose.pose.position.y = float(pose.north_m)
        message.pose.pose.position.z = float(pose.up_m)
        message.pose.pose.orientation.z = math.sin(yaw_rad / 2.0)
        message.pose.pose.orientation.w = math.cos(yaw_rad / 2.0)
        position, turn = pose.position_sigma_m, math.radians(pose.heading_sigma_deg)
        unknown = 1e3  # the height, roll and pitch are not estimated
        sigmas = np.array([position, position, unknown, unknown, unknown, turn])
        message.pose.covariance = np.diag(sigmas**2).reshape(-1).tolist()
        self._poses.publish(message)

    def _publish_datum(self, window):
        datum = window.costmap.datum
        if datum == self._datum:
            return
        self._datum = datum
        message = NavSatFix()
        self._stamp(message.header, window.time_ns)
        message.latitude, message.longitude = datum.lat_deg, datum.lon_deg
        message.altitude = datum.height_m
        self._datums.publish(message)

    def _stamp(self, header, time_ns):
        header.frame_id = self._frame
        header.stamp.sec, header.stamp.nanosec = divmod(int(time_ns), NANO)


def stamp_ns(message):
    """The stamp of a message in nanoseconds."""
    return message.header.stamp.sec * NANO + message.header.stamp.nanosec


def grey(message):
    """A sensor_msgs/Image as grey pixels of 8 bit; ValueError for what it cannot be made of."""
    channels = CHANNELS.get(message.encoding)
    if channels is None:
        raise ValueError(
            f"Images are encoded as {message.encoding}; this node takes {', '.join(CHANNELS)}."
        )
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(message.height, message.step)
    pixels = np.ascontiguousarray(rows[:, : message.width * channels])
    if channels == 1:
        return pixels
    pixels = pixels.reshape(message.height, message.width, channels)
    return cv2.cvtColor(pixels, TO_GREY[message.encoding])


def main():
    rclpy.init()
    node = LiveNode()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.finish()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
