"""Callbacks without the time that rclpy's executor takes, and readers without callbacks."""
