"""What lies between motor and joint. Shows where the backend has the motor's angle."""
