"""Many worlds on one device: MuJoCo Warp under the control laws of the nodes."""
