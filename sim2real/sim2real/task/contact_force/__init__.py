"""The force stage: friction of table and fingertip and the object's mass from contact forces of slow drags, pushes and scrapes."""
