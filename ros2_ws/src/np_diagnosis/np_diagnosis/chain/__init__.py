"""The chain beyond the arm: what the finger, the object and the table add to the gap."""
