"""What must hold before and after: plausible numbers, nothing left, nothing that changes with time."""
