"""What an arm may have that its nominal simulator has not: one record an effect."""
