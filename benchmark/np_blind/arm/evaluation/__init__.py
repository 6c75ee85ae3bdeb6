"""The doctor asked of the arms' recordings, and its answers judged."""
