"""Task set-ups in PhysX: cases of the task suite, their recordings, and the score of `diagnose_task`."""
