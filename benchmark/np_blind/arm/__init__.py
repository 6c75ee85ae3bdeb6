"""Arms whose cause is sealed: cases, their recordings, and what the doctor of the arm makes of them."""
