"""The touch stage: where joint torque shows that contact begins, against geometry."""
