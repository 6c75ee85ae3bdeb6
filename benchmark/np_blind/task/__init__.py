"""What is beside the arm, in PhysX: cases of the task suite, and what `chain` makes of their recordings."""
