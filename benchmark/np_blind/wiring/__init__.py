"""The wiring stage, judged: 24 kinds of wrong conventions in recordings, and recordings without."""
