"""The Panda, the objects, the three domains and the camera: MJCF and frozen dataclasses, no rclpy."""
