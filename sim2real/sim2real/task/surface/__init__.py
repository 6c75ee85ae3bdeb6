"""The touch stage: where joint torque says that contact begins, against geometry."""
