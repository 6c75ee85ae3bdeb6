"""The motion stage: what effects are worth for how the object moves, by windows that are simulated from where it is seen to rest."""
