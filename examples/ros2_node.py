"""A ROS 2 node that follows a camera on a map: images and odometry in, poses out.

It needs a ROS 2 installation (Jazzy, Humble) beside slicemask, and is started as

    python examples/ros2_node.py --ros-args -p run:=generated-city -p map:=ortho.tif

Topics: /image (sensor_msgs/Image, panoramas of equirectangular projection), /odom
(nav_msgs/Odometry) and /fix (sensor_msgs/NavSatFix) in; /slicemask/pose
(geometry_msgs/PoseWithCovarianceStamped) out, in metres east and north of the first fix, which says
where to begin. Later fixes are weak evidence.
Images that come while one is worked on are dropped but for the newest, so that it never falls
behind.
"""

import math

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image, NavSatFix
from slicematch import Localizer
from slicematch.data.maps import AerialMap
from slicematch.data.positions import Fix
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.tracking.bag_drive import fix_of
from slicematch.tracking.live import newest
from slicematch.tracking.odometry import Odometry
from slicematch.tracking.outputs import yaw_quaternion
from slicematch.tracking.tracker import Tracker

FIX_M = 20.0


class TrackNode(Node):
    """The node."""

    def __init__(self) -> None:
        super().__init__("slicemask")
        for name, value in (("run", "generated-city"), ("map", "ortho.tif"), ("device", "auto")):
            self.declare_parameter(name, value)
        run, path, device = (self.get_parameter(name).value for name in ("run", "map", "device"))
        self.localizer = Localizer.load(run, grid="2x2x4", device=device, alone=True)
        self.map = AerialMap.open(path)
        self.tracker: Tracker | None = None
        self.motion: list[tuple[float, float]] = []
        self.fix: Fix | None = None
        self.last_s: float | None = None
        self.frames = newest(self.step)
        self.poses = self.create_publisher(PoseWithCovarianceStamped, "/slicemask/pose", 10)
        quality = qos_profile_sensor_data
        self.create_subscription(NavSatFix, "/fix", self.keep_fix, quality)
        self.create_subscription(OdometryMessage, "/odom", self.move, quality)
        self.create_subscription(Image, "/image", self.frames.put, quality)

    def keep_fix(self, message: NavSatFix) -> None:
        """Begin at the first fix; keep others until the next image."""
        fix = fix_of(message)
        if fix is not None and self.tracker is None:
            start = PlaceOnGlobe(fix.lat, fix.lon, FIX_M)
            self.tracker = Tracker(self.localizer, self.map, start)
        elif fix is not None:
            self.fix = fix

    def move(self, message: OdometryMessage) -> None:
        """Keep what the odometry says until the next image."""
        twist = message.twist.twist
        self.motion.append((twist.linear.x, -math.degrees(twist.angular.z)))

    def step(self, message: Image, dropped: int) -> None:
        """Go on by one image, on a thread of its own."""
        if self.tracker is None:
            return
        motion, self.motion = self.motion, []
        fix, self.fix = self.fix, None
        odometry = Odometry(*np.mean(motion, axis=0).tolist()) if motion else None
        now_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        dt_s = 0.0 if self.last_s is None else now_s - self.last_s
        self.last_s = now_s
        pixels = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
        pixels = pixels[:, : 3 * message.width].reshape(message.height, message.width, 3)
        if message.encoding == "bgr8":
            pixels = pixels[..., ::-1]
        found = self.tracker.step(np.ascontiguousarray(pixels), odometry, dt_s, fix=fix)
        for note in found.notes:
            self.get_logger().warning(note)
        if dropped:
            self.get_logger().warning(f"{dropped} images were dropped")
        pose = PoseWithCovarianceStamped()
        pose.header.stamp, pose.header.frame_id = message.header.stamp, "map"
        mode = found.modes[0]
        pose.pose.pose.position.x, pose.pose.pose.position.y = mode.east_m, mode.north_m
        turn = pose.pose.pose.orientation
        turn.x, turn.y, turn.z, turn.w = yaw_quaternion(found.heading_deg)
        covariance = np.zeros((6, 6))
        scale = np.array([1.0, 1.0, -math.pi / 180.0])
        covariance[np.ix_([0, 1, 5], [0, 1, 5])] = found.covariance * np.outer(scale, scale)
        pose.pose.covariance = covariance.ravel().tolist()
        self.poses.publish(pose)


def main() -> None:
    """Run the node until it is ended."""
    rclpy.init()
    node = TrackNode()
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    finally:
        node.frames.close()
        if node.tracker is not None:
            node.tracker.close()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
