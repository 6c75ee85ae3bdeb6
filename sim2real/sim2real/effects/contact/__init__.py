"""How contacts rub, between object, table and fingertip."""
