"""Launch files, the demo, recorder, replayer, evaluation, report and bench."""
