"""Withheld robots in PhysX: recording, diagnosis, fine-tuning and score."""
