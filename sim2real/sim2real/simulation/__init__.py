"""The arm in simulation: closed loop, forward windows, the patch and a second opinion of it."""
