"""Joint PPO of both policies: rollouts, updates, curriculum, what a run keeps."""
