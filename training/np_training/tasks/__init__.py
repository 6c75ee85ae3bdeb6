"""Tasks: poses, practice, rewards, randomisation, and one file for each domain."""
